"""The workbench in the browser, ``roomfit app``: a folder, six tabs, and nothing of its own.

The state is the project folder. `project` reads and changes it, `views` says what a tab shows and
`tasks` what is done, all plain functions without a web, which `jobs` has a process of its own carry
out: files come from strangers, and long work outlives the page. `security` refuses everybody but
the one who started it. The remaining modules draw.
"""
