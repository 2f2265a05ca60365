"""The workbench in the browser, ``roomfit app``: a folder, five tabs, and nothing of its own.

The state is the project folder. `project` reads and changes it, `views` says what a tab shows, and
both are plain functions without a web, which a process of its own carries out (`worker`, started by
`jobs`): files come from strangers, and long work outlives the page. `security` refuses everybody
but the one who started it. The remaining modules draw, a module for each tab.
"""
