"""The whole way in a real browser: from an empty folder to the downloaded report."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from workbench import Running, chromium, running

pytestmark = pytest.mark.slow
_MINUTES_MS = 400_000
_CONTRAST = """() => {
  const shade = (c) => { const m = c.match(/[\\d.]+/g).map(Number);
    const f = (v) => (v / 255 <= 0.03928 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    return [
      0.2126 * f(m[0]) + 0.7152 * f(m[1]) + 0.0722 * f(m[2]), m[3] === undefined ? 1 : m[3]]; };
  const low = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    const box = e.getBoundingClientRect();
    if (!own || !box.width || !box.height) continue;
    if (e.closest('svg, [aria-hidden=true], .q-icon')) continue;
    let under = e;
    let back = [document.body.classList.contains('body--dark') ? 0 : 1, 1];
    while (under) { const s = shade(getComputedStyle(under).backgroundColor);
      if (s[1] > 0.9) { back = s; break; } under = under.parentElement; }
    const ink = shade(getComputedStyle(e).color)[0];
    const ratio = (Math.max(ink, back[0]) + 0.05) / (Math.min(ink, back[0]) + 0.05);
    if (ratio < 4.5) low.push(`${e.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return low;
}"""
_UNNAMED = """() => [
  ...document.querySelectorAll('button, input, select, [role=slider], canvas, iframe')]
  .filter((e) => { const b = e.getBoundingClientRect(); return b.width && b.height; })
  .filter((e) => !(e.getAttribute('aria-label') || e.getAttribute('title') || e.textContent.trim()
    || (e.labels && [...e.labels].some((l) => l.textContent.trim())) || e.closest('[aria-label]')))
  .map((e) => e.outerHTML.slice(0, 160))"""


class Visit:
    """A page of a running workbench, and every request that would have left the machine."""

    def __init__(self, browser: Any, server: Running, width: int, scheme: str) -> None:
        self.context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=scheme, accept_downloads=True
        )
        self.page = self.context.new_page()
        self.page.set_default_timeout(180_000)
        self.foreign: list[str] = []
        self.errors: list[str] = []
        own = f"http://127.0.0.1:{server.port}/"

        def gate(route: Any) -> None:
            if route.request.url.startswith((own, "data:", "blob:")):
                route.continue_()
            else:
                self.foreign.append(route.request.url)
                route.abort()

        self.context.route("**/*", gate)
        self.page.on("pageerror", lambda e: self.errors.append(str(e)))
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.page.goto(server.address)

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name).click()
        self.page.wait_for_timeout(1500)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    start, how = chromium()
    with start() as playwright:
        own = playwright.chromium.launch(**how)
        yield own
        own.close()


def choose(page: Any, label: str, option: str) -> None:
    page.get_by_label(label).click()
    chosen = page.get_by_role("option", name=option, exact=True)
    chosen.click()
    chosen.wait_for(state="detached")  # a menu that closes has the options of the next one


def test_from_the_demo_project_to_the_downloaded_report(browser: Any, tmp_path: Path) -> None:
    with running(tmp_path) as server:
        visit = Visit(browser, server, 1400, "light")
        page = visit.page
        page.get_by_role("button", name="Open the demo project").click()
        page.get_by_text("can be traced").wait_for()
        # a surface, its material and what that is
        page.get_by_role("button", name=re.compile("^floor")).click()
        page.get_by_label(re.compile("What carpet is")).fill("carpet-on-underlay")
        page.get_by_role("option", name=re.compile("^carpet-on-underlay")).click()
        page.get_by_text("Absorption of the catalogue").wait_for()
        assert 'prior = "carpet-on-underlay"' in (tmp_path / "campaign.toml").read_text()
        # a position, and what the check says of it
        visit.tab("Measurements")
        page.get_by_text("T20 is not evaluated there").first.wait_for()
        page.get_by_label("MP1 x in m").fill("9")
        page.get_by_label("MP1 x in m").press("Enter")
        page.get_by_text(re.compile("MP1.*outside|outside.*MP1")).first.wait_for()
        page.get_by_label("MP1 x in m").fill("4.1")
        page.get_by_label("MP1 x in m").press("Enter")
        page.get_by_text("T20 is not evaluated there").first.wait_for()
        # a first answer; the page is closed meanwhile
        visit.tab("Identify")
        choose(page, "Lowest octave", "1k Hz")
        choose(page, "Highest octave", "1k Hz")
        page.get_by_role("button", name="First answer only").click()
        page.get_by_role("button", name="Cancel").wait_for()
        page.reload()
        page.get_by_role("button", name="Cancel").wait_for()
        visit.tab("Identify")
        page.get_by_text("Absorption: first answer").wait_for(timeout=_MINUTES_MS)
        assert page.frame_locator("iframe").get_by_text("coefficients determined").count()
        # what if
        visit.tab("What if")
        page.get_by_text("pairs, 0 materials changed").wait_for(timeout=_MINUTES_MS)
        slider = page.get_by_label(re.compile("^Absorption of .* at 1k Hz"))
        before = float(slider.input_value())
        for _ in range(5):
            slider.press("ArrowRight")
            page.wait_for_timeout(1000)  # answers come in between and must not move it back
        assert float(slider.input_value()) == pytest.approx(min(before + 0.05, 0.99))
        page.get_by_text("pairs, 1 material changed").wait_for()
        # the report and an export
        visit.tab("Report")
        with page.expect_download() as got:
            page.get_by_role("link", name="Download report.html").click()
        assert b"coefficients determined" in Path(got.value.path()).read_bytes()
        with page.expect_download() as got:
            page.get_by_role("button", name="Excel").click()
        assert Path(got.value.path()).read_bytes()[:2] == b"PK"
        assert visit.foreign == [] and visit.errors == []
        visit.context.close()


def test_from_a_typed_box_and_dropped_files(browser: Any, tmp_path: Path) -> None:
    demo = tmp_path / "demo"
    from roomfit.app import views

    demo.mkdir()
    views.demo(lambda _: None, str(demo))
    folder = tmp_path / "mine"
    with running(folder) as server:
        visit = Visit(browser, server, 390, "dark")
        page = visit.page
        for label, value in (
            ("Length x (m)", "6.1"),
            ("Width y (m)", "4.7"),
            ("Height z (m)", "2.8"),
        ):
            page.get_by_label(label).fill(value)
        page.get_by_role("button", name="Use this box").click()
        page.get_by_text("can be traced").wait_for()
        # a name that is markup stays a name
        page.get_by_role("button", name=re.compile("^east")).click()
        box = page.get_by_label("Material (choose, or type a new name and Enter)")
        box.fill("<img src=x onerror=window.broken=1>")
        box.press("Enter")
        page.get_by_text("<img src=x").first.wait_for()
        assert page.evaluate("window.broken") is None
        visit.tab("Measurements")
        files = [str(demo / f"LS1_MP{i}.wav") for i in (1, 2)]
        page.locator("input[type=file]:visible").set_input_files(files)
        page.get_by_label("LS1 x in m").wait_for()
        places = {"LS1": (1.2, 1.5, 1.1), "MP1": (4.1, 2.9, 1.2), "MP2": (2.3, 3.75, 1.45)}
        for name, position in places.items():
            for word, value in zip("xyz", position, strict=True):
                page.get_by_label(f"{name} {word} in m").fill(str(value))
            page.get_by_label(f"{name} z in m").press("Enter")
            page.wait_for_timeout(500)
        page.get_by_text("T20 is not evaluated there").first.wait_for()
        assert not visit.foreign and not visit.errors
        visit.context.close()


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_it_can_be_read_and_named_everywhere(
    browser: Any, tmp_path: Path, width: int, scheme: str
) -> None:
    from roomfit.app import views

    views.demo(lambda _: None, str(tmp_path))
    with running(tmp_path) as server:
        visit = Visit(browser, server, width, scheme)
        page = visit.page
        page.get_by_text("can be traced").wait_for()
        page.get_by_role("button", name=re.compile("^floor")).click()
        page.wait_for_timeout(500)
        for name in ("Room", "Measurements", "Identify", "What if", "Report"):
            visit.tab(name)
            page.wait_for_timeout(1000)
            assert page.evaluate(_CONTRAST) == [], name
            assert page.evaluate(_UNNAMED) == [], name
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"{name} is {wide} px wide"
        # by the keyboard alone
        page.get_by_role("tab", name="Report").focus()
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("Enter")
        page.locator('[role=tab][aria-selected="true"]', has_text="What if").wait_for()
        visit.context.close()
