"""The whole way in a real browser: from an empty folder to the downloaded report."""

from __future__ import annotations

import os
import re
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from workbench import Running, chromium, running

pytestmark = pytest.mark.slow
_MINUTES_MS = 400_000
_DRAWN_ANEW = "old => document.querySelector('.answer').innerText != old"
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
        self.width = width
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
        self.page.get_by_role("tab", name=name, exact=True).click()
        self.page.get_by_role("tab", name=name, exact=True, selected=True).wait_for()

    def is_readable(self) -> None:
        """Contrast, names of what can be used, and nothing wider than the page."""
        self.page.wait_for_timeout(500)  # colours pass slowly into each other
        assert self.page.evaluate(_CONTRAST) == [] and self.page.evaluate(_UNNAMED) == []
        assert self.page.evaluate("document.documentElement.scrollWidth") <= self.width


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
        trace_few_rays(tmp_path)
        # a surface by the keyboard, its material and what that is
        page.get_by_role("button", name=re.compile("^floor")).focus()
        page.keyboard.press("Enter")
        page.get_by_text("Surface floor").wait_for()
        assert page.evaluate("document.activeElement.textContent").startswith("floor")
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
        choose(page, "Lowest octave", "1 kHz")
        choose(page, "Highest octave", "1 kHz")
        page.get_by_role("button", name="First answer only").click()
        page.get_by_role("button", name="Cancel").wait_for()
        page.reload()
        page.get_by_role("button", name="Cancel").wait_for()
        visit.tab("Identify")
        page.get_by_text("Absorption: first answer").wait_for(timeout=_MINUTES_MS)
        page.frame_locator("iframe").get_by_text("Provenance").first.wait_for()
        # what if
        visit.tab("What if")
        page.get_by_text("0 materials changed").wait_for(timeout=_MINUTES_MS)
        slider = page.get_by_label(re.compile("^Absorption of .* at 1 kHz"))
        before = float(slider.input_value())
        for _ in range(5):
            slider.press("ArrowRight")
            page.wait_for_timeout(400)  # answers come in between and must not move it back
        assert float(slider.input_value()) == pytest.approx(min(before + 0.05, 0.99))
        page.get_by_text("1 material changed").wait_for()
        # the report and an export
        visit.tab("Report")
        with page.expect_download() as got:
            page.get_by_role("link", name="Download report.html").click()
        assert b"Provenance" in Path(got.value.path()).read_bytes()
        with page.expect_download() as got:
            page.get_by_role("button", name="Excel").click()
        assert Path(got.value.path()).read_bytes()[:2] == b"PK"
        assert visit.foreign == [] and visit.errors == []
        visit.context.close()


TREATMENT = """
[surfaces.brick]
[products."wool panel"]
absorption = { centres_hz = [125, 500, 2000, 8000], values = [0.2, 0.9, 0.95, 0.9] }
[[targets]]
parameter = "T30_s"
at_most = 0.4
[[targets]]
parameter = "STI"
at_least = 0.5
"""


def trace_few_rays(folder: Path) -> None:
    file = folder / "campaign.toml"
    file.write_text(f"{file.read_text()}\n[settings]\nn_rays = 3000\nn_scattering_rays = 1000\n")


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the demo project, of one source, few rays and without an answer; to be copied."""
    from roomfit.app import tasks

    folder = tmp_path_factory.mktemp("demo")
    tasks.demo(lambda _: None, folder)
    file = folder / "campaign.toml"
    other = r'(\[\[measurements\]\]\nsource = "LS2"|\[sources\.LS2\])\n.*\n.*\n'
    left, n_tables = re.subn(other, "", file.read_text())
    assert n_tables == 5 and "LS2" not in left
    file.write_text(left)
    trace_few_rays(folder)
    return folder


@pytest.fixture(scope="module")
def answered(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Run a project with a first answer in the octaves of speech, and a treatment file."""
    from roomfit.app import project, tasks

    folder = tmp_path_factory.mktemp("answered") / "project"
    shutil.copytree(demo, folder)
    project.set_bands(folder, 125.0, 8000.0)
    (folder / "treatment.toml").write_text(TREATMENT)
    tasks.identify(lambda _: None, folder, True)
    with running(folder) as server:
        yield server


def test_what_if_shows_speech_limits_sounds_and_what_to_hang(
    browser: Any, answered: Running
) -> None:
    visit = Visit(browser, answered, 1400, "light")
    page = visit.page
    visit.tab("What if")
    page.get_by_text("0 materials changed").wait_for(timeout=_MINUTES_MS)
    answer = page.locator(".answer")
    answer.get_by_text("target, at most").wait_for()
    before = answer.inner_text()
    page.get_by_label(re.compile("^Absorption of .* at 1 kHz")).press("End")
    page.get_by_text("1 material changed").wait_for()
    page.wait_for_function(_DRAWN_ANEW, arg=before)
    # kept under a name, beside what else is
    page.get_by_label("Name of what is set above, as curtain open").fill("hard at 1 kHz")
    page.get_by_role("button", name="Keep it").click()
    beside = page.locator(".variants")
    beside.get_by_role("rowheader", name="hard at 1 kHz").first.wait_for(timeout=_MINUTES_MS)
    assert beside.get_by_role("button", name="Forget hard at 1 kHz").count() == 1
    # to listen to
    page.get_by_role("button", name="Make the sounds of what is set above").click()
    page.locator("audio").first.wait_for(timeout=_MINUTES_MS)
    assert page.locator("audio").count() == 8
    seconds = (
        page.locator("audio")
        .nth(1)
        .evaluate(
            "a => new Promise((done, failed) => { a.oncanplay = () => done(a.duration);"
            " a.onerror = () => failed(a.error.message); a.preload = 'auto'; a.load(); })"
        )
    )
    assert seconds > 0.1
    # what to hang where
    page.get_by_role("button", name=re.compile("^Search for the cheapest")).click()
    shown = (
        page.frame_locator("iframe[title=Treatment]")
        .get_by_text("What hangs where", exact=True)
        .first
    )
    shown.wait_for(timeout=_MINUTES_MS)
    # processes that have ended begin anew, and know the room again
    before = answer.inner_text()
    for child in Path(f"/proc/{answered.pid}/task/{answered.pid}/children").read_text().split():
        os.kill(int(child), signal.SIGKILL)
    slider = page.get_by_label(re.compile("^Absorption of .* at 1 kHz"))
    slider.press("Home")  # perhaps before the server knows: then an error is shown
    page.wait_for_timeout(1000)
    slider.press("ArrowRight")
    page.wait_for_function(_DRAWN_ANEW, arg=before, timeout=_MINUTES_MS)
    assert "wool panel" in (answered.folder / "treatment" / "treatment.csv").read_text()
    assert visit.foreign == [] and visit.errors == []
    visit.context.close()


def test_the_full_answer_is_cancelled_begun_anew_and_outlives_its_page(
    browser: Any, demo: Path, tmp_path: Path
) -> None:
    from roomfit.app import project

    folder = tmp_path / "project"
    shutil.copytree(demo, folder)
    project.set_bands(folder, 1000.0, 1000.0)
    files = sorted(p.name for p in folder.iterdir())
    with running(folder) as server:
        visit = Visit(browser, server, 1400, "light")
        page = visit.page
        visit.tab("Identify")
        page.get_by_role("button", name="Full answer only").click()
        cancel = page.get_by_role("button", name="Cancel")
        cancel.focus()
        page.get_by_text(re.compile(r"Full answer: .*, [1-9]\d* %")).wait_for(timeout=_MINUTES_MS)
        # the progress that is shown every second leaves the button where it is
        assert page.evaluate("document.activeElement.textContent") == "Cancel"
        began = time.monotonic()
        cancel.press("Enter")
        cancel.wait_for(state="detached")
        # two seconds, and the page looks twice a second
        assert time.monotonic() - began < 3.0
        # nothing half-written; what was traced may be kept to begin from
        left = [p for p in folder.iterdir() if p.name not in files]
        assert not (folder / "result" / "result.json").exists(), left
        page.get_by_role("button", name="Full answer only").click()
        page.get_by_text(re.compile("Full answer: ")).wait_for()
        visit.context.close()  # nobody looks on
        again = Visit(browser, server, 390, "dark")
        again.tab("Identify")
        again.page.get_by_role("button", name="Cancel").wait_for()
        again.page.reload()
        again.tab("Identify")
        again.page.get_by_text("Absorption: full answer").wait_for(timeout=_MINUTES_MS)
        report = again.page.frame_locator("iframe")
        report.get_by_text("Provenance").first.wait_for()
        assert visit.errors == [] and again.errors == []
        again.context.close()


def test_from_a_typed_box_and_dropped_files(browser: Any, demo: Path, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    from roomfit.app import project

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
        # a recording that says it is longer than it is
        whole = (demo / "LS1_MP1.wav").read_bytes()
        lies = {"name": "LS9_MP9.wav", "mimeType": "audio/wav", "buffer": whole[: len(whole) // 2]}
        page.get_by_label("Recordings, dropped here or chosen:").set_input_files(lies)
        page.get_by_text(re.compile("LS9_MP9.wav: ")).wait_for()
        assert not (folder / "recordings" / "LS9_MP9.wav").exists()
        files = [str(demo / f"LS1_MP{i}.wav") for i in (1, 2)]
        page.get_by_label("Recordings, dropped here or chosen:").set_input_files(files)
        page.get_by_label("MP2 z in m").wait_for()  # all names have come
        places = {"LS1": (1.2, 1.5, 1.1), "MP1": (4.1, 2.9, 1.2), "MP2": (2.3, 3.75, 1.45)}
        for name, position in places.items():
            for word, value in zip("xyz", position, strict=True):
                page.get_by_label(f"{name} {word} in m").fill(str(value))
            page.get_by_label(f"{name} z in m").press("Enter")
            # who writes to the campaign meanwhile takes nothing away from what is half typed
            if name == "LS1":
                page.get_by_label("MP1 x in m").fill("4.1")
                # two who write at once undo each other's work: the page has written
                while "[1.2, 1.5, 1.1]" not in (folder / "campaign.toml").read_text():
                    page.wait_for_timeout(20)
                project.set_position(folder, "receivers", "MP2", (2.3, 3.75, 1.4))
                expect(page.get_by_label("MP2 z in m")).to_have_value("1.4", timeout=60_000)
                expect(page.get_by_label("MP1 x in m")).to_have_value("4.1")
        page.get_by_text("T20 is not evaluated there").first.wait_for()
        # the browser itself tells of the answer 400
        assert not visit.foreign and not [e for e in visit.errors if "400 (Bad Request)" not in e]
        visit.context.close()


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_a_remedy_is_shown_applied_and_undone_by_the_keyboard(
    browser: Any, demo: Path, tmp_path: Path, width: int, scheme: str
) -> None:
    """A recording that was made softer; it can be read, and nothing is wider than the page."""
    import soundfile

    folder = tmp_path / "project"
    shutil.copytree(demo, folder)
    samples, rate_hz = soundfile.read(folder / "LS1_MP3.wav")
    soundfile.write(folder / "LS1_MP3.wav", 0.2 * samples, rate_hz, subtype="FLOAT")
    file = folder / "campaign.toml"
    before = file.read_text()

    with running(folder) as server:
        visit = Visit(browser, server, width, scheme)
        page = visit.page
        visit.tab("Measurements")
        advice = page.get_by_role("button", name=re.compile("What the findings advise"))
        advice.press("Enter")
        remedy = page.get_by_role("button", name='Set level = "per-file" for LS1_MP3.wav')
        remedy.wait_for()
        visit.is_readable()
        remedy.press("Enter")
        shown = page.get_by_role("dialog", name="What is written")
        shown.get_by_text("[[measurements]], no. 3").wait_for()
        assert shown.get_by_text("not stated").count() == 1
        visit.is_readable()
        page.keyboard.press("Escape")
        shown.wait_for(state="detached")
        assert file.read_text() == before
        remedy.press("Enter")
        apply = shown.get_by_role("button", name="Apply")
        apply.wait_for()
        page.wait_for_function("() => document.activeElement.textContent === 'Apply'")
        page.keyboard.press("Enter")
        undo = page.get_by_role("button", name="Undo the last remedy")
        undo.wait_for()
        remedy.wait_for(state="detached")
        row = 'file = "LS1_MP3.wav"\n'
        assert file.read_text() == before.replace(row, row + 'level = "per-file"\n')
        page.reload()
        visit.tab("Measurements")
        advice.press("Enter")
        undo.press("Enter")
        remedy.wait_for()
        assert file.read_text() == before
        assert visit.foreign == [] and visit.errors == []
        visit.context.close()


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_it_can_be_read_and_named_everywhere(
    browser: Any, answered: Running, width: int, scheme: str
) -> None:
    visit = Visit(browser, answered, width, scheme)
    page = visit.page
    page.get_by_text("can be traced").wait_for()
    page.get_by_role("button", name=re.compile("^floor")).click()
    seen = {
        "Room": "Surface floor",
        "Measure": "Measure an impulse response",
        "Measurements": "T20 is not evaluated there",
        "Identify": "Absorption: first answer",
        "What if": "0 materials changed",
        "Report": "Download report.html",
    }
    for name, text in seen.items():
        visit.tab(name)
        page.get_by_text(text).first.wait_for(timeout=_MINUTES_MS)
        visit.is_readable()
    # by the keyboard alone, from the last tab to the first; and into what is to be typed
    page.get_by_role("tab", name="Report").focus()
    for name in list(seen)[-2::-1]:
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("Enter")
        page.get_by_role("tab", name=name, exact=True, selected=True).wait_for()
        if name == "Measure":
            page.keyboard.press("Tab")
            focused = page.evaluate("document.activeElement.closest('[role=tabpanel]') !== null")
            assert focused, "the fields of Measure come after its tab"
            page.get_by_role("tab", name=name, exact=True).focus()
    visit.context.close()


def test_a_receiver_is_dragged_and_what_is_shown_of_the_answer_stays(
    browser: Any, answered: Running
) -> None:
    """By half a metre each way; its height stays, and the table shows it."""
    visit = Visit(browser, answered, 1400, "light")
    page = visit.page
    visit.tab("Identify")
    page.get_by_text("Absorption: first answer").wait_for(timeout=_MINUTES_MS)
    page.evaluate("() => { document.querySelector('iframe').isTheSame = true; }")
    visit.tab("Measurements")
    page.get_by_text("T20 is not evaluated there").first.wait_for()
    scale = page.locator(".plan-view").evaluate("s => s.getScreenCTM().a")
    box = page.locator("[data-point=MP1] circle").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 0.25 * scale, y - 0.2 * scale)
    page.mouse.move(x + 0.5 * scale, y - 0.5 * scale)
    page.mouse.up()
    page.wait_for_function(
        "() => Math.abs(document.querySelector('[aria-label=\"MP1 x in m\"]').value - 4.6) < .1"
    )
    from roomfit.files.campaign import read_campaign

    campaign = read_campaign(answered.folder / "campaign.toml", to_fit=False)
    placed = next(p for p in campaign.receivers if p.name == "MP1").position_m
    assert placed[:2] == pytest.approx([4.6, 3.4], abs=0.03) and placed[2] == 1.2
    visit.tab("Identify")
    page.get_by_text("The campaign has changed since this answer was made").wait_for()
    assert page.evaluate("document.querySelector('iframe').isTheSame")
    assert visit.errors == []
    visit.context.close()


# What goes to the loudspeaker goes through a room, and with noise into the microphone.
_LOOP = """([room, hiss]) => {
  const Real = window.AudioContext;
  window.AudioContext = class extends Real {
    constructor(...a) { super(...a); window.sound = this; }
  };
  const connect = AudioNode.prototype.connect;
  const filled = (samples) => {
    const buffer = window.sound.createBuffer(1, samples.length, window.sound.sampleRate);
    buffer.copyToChannel(new Float32Array(samples), 0);
    return buffer;
  };
  AudioNode.prototype.connect = function (to, ...rest) {
    const plays = this instanceof AudioBufferSourceNode && to === this.context.destination;
    return connect.call(this, plays ? window.loop : to, ...rest);
  };
  navigator.mediaDevices.getUserMedia = async (constraints) => {
    window.asked = constraints.audio;
    const whole = { disableNormalization: true, buffer: filled(room) };
    window.loop = new ConvolverNode(window.sound, whole);
    const noise = new AudioBufferSourceNode(window.sound, { buffer: filled(hiss), loop: true });
    const end = new MediaStreamAudioDestinationNode(window.sound, { channelCount: 1 });
    noise.start();
    connect.call(window.loop, end);
    connect.call(noise, end);
    const { echoCancellation, noiseSuppression, autoGainControl } = constraints.audio;
    end.stream.getAudioTracks()[0].getSettings = () => ({
      echoCancellation, noiseSuppression, autoGainControl, sampleRate: window.sound.sampleRate });
    return end.stream;
  };
}"""
_ORDERS = """() => {
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  navigator.mediaDevices.getUserMedia = async (constraints) => {
    const { audio } = constraints;
    if (window.disobey) Object.keys(window.disobey).forEach((key) => delete audio[key]);
    const stream = await ask({ audio: { ...audio, ...window.disobey } });
    if (window.silent) stream.getAudioTracks()[0].getSettings = () => ({ sampleRate: 8000 });
    window.obeyed = stream.getAudioTracks()[0].getSettings();
    return stream;
  };
}"""


def test_a_response_measured_in_the_page_through_a_loop_is_that_of_the_file(
    browser: Any, tmp_path: Path
) -> None:
    """By the keyboard, through play, microphone, worklet, upload and deconvolution."""
    import numpy as np
    import soundfile

    from roomfit.app import project, views

    views.set_room(tmp_path, shoebox=[5.0, 4.0, 3.0])
    rng, t = np.random.default_rng(1), np.arange(40_000) / 48_000.0
    room = 0.002 * rng.normal(size=len(t)) * 10.0 ** (-3.0 * t / 0.4)
    room[:300], room[300] = 0.0, 0.05
    room, hiss = (x.astype(np.float32) for x in (room, 1e-5 * rng.normal(size=50_000)))
    with running(tmp_path) as server:
        visit = Visit(browser, server, 390, "dark")
        page = visit.page
        page.set_default_timeout(60_000)
        page.evaluate(_LOOP, [room.tolist(), hiss.tolist()])
        visit.tab("Measure")
        for label, value in (("Source", "LS2"), ("Sweep (s)", "2"), ("Silence (s)", "1")):
            page.get_by_label(label).fill(value)
        page.get_by_label("Repetitions").fill("2")
        page.get_by_role("button", name="Open the microphone").press("Enter")
        page.get_by_label("Level of the microphone").wait_for()
        play = page.get_by_role("button", name="Play and record")
        play.press("Enter")
        page.get_by_text("It suffices from 125 Hz to 4 kHz").wait_for()
        visit.is_readable()
        off = ("echoCancellation", "noiseSuppression", "autoGainControl")
        assert all(page.evaluate("window.asked")[key] is False for key in off)
        # what is there is replaced when it is asked for, and not else
        file = tmp_path / "recordings" / "LS2_R1.wav"
        before = file.read_bytes()
        play.press("Enter")
        page.get_by_text("this pair was measured already").wait_for()
        assert file.read_bytes() == before
        page.get_by_role("checkbox").press("Space")
        page.wait_for_timeout(500)
        play.press("Enter")
        page.get_by_text("In recordings: LS2_R1.wav").wait_for()
        page.wait_for_function("() => [...document.querySelectorAll('.file-status')]"
            ".some((e) => e.textContent === 'Measured')")  # fmt: skip
        assert file.read_bytes() != before
        rate_hz = page.evaluate("window.sound.sampleRate")
        assert visit.foreign == [] and not [e for e in visit.errors if "400 (Bad" not in e]
        visit.context.close()
    measured, own_hz = soundfile.read(file)
    assert own_hz == rate_hz
    n = 2**18
    edges = np.searchsorted(np.fft.rfftfreq(n, 1.0 / rate_hz), 100.0 * 2.0 ** (np.arange(77) / 12))
    power = [np.add.reduceat(np.abs(np.fft.rfft(x, n)) ** 2, edges)[:-1] for x in (measured, room)]
    assert np.abs(10.0 * np.log10(power[0] / power[1])).max() < 0.1
    # its row, and positions that are still to be given
    for kind, name in (("sources", "LS2"), ("receivers", "R1")):
        project.set_position(tmp_path, kind, name, (1.0, 1.0 + (name == "R1"), 1.2))
    view = views.recordings_view(tmp_path)
    (row,) = view["rows"]
    assert row["file"] == "recordings/LS2_R1.wav" and view["page"]
    # the delay of the devices is no fault of the recording
    assert not [f for f in view["findings"] if "direct sound" in f["sentence"]]


def test_a_browser_that_changes_the_sound_is_refused_and_one_that_does_not_is_believed(
    browser: Any, tmp_path: Path
) -> None:
    """Chromium itself obeys; it is made to leave on what the page asks to be off."""
    with running(tmp_path) as server:
        visit = Visit(browser, server, 1400, "light")
        page = visit.page
        page.evaluate(_ORDERS)
        visit.tab("Measure")
        button = page.get_by_role("button", name=re.compile("the microphone"))
        button.click()
        page.locator("meter").wait_for()
        obeyed = page.evaluate("window.obeyed")
        words = {"echoCancellation": "echo cancelling", "autoGainControl": "automatic gain"}
        words["noiseSuppression"] = "noise suppression"
        assert [obeyed[key] for key in words] == [False] * 3
        assert page.locator(".finding").count() == 0
        for key, word in words.items():
            button.click()
            page.evaluate("(key) => { window.disobey = { [key]: true }; }", key)
            button.click()
            page.get_by_text(f"the browser leaves {word} on").wait_for()
            assert page.evaluate("window.obeyed")[key] is True
            assert page.get_by_role("button", name="Play and record").is_disabled()
            page.evaluate("() => { window.disobey = null; }")
            button.click()
            page.locator("meter").wait_for()
        button.click()
        page.evaluate("() => { window.silent = true; }")
        button.click()
        page.get_by_text("does not say whether echo cancelling, noise suppression").wait_for()
        page.get_by_text("resamples from 8000 to").wait_for()
        assert visit.foreign == [] and visit.errors == []
        visit.context.close()


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_the_owner_of_a_hall_gets_to_square_metres_by_the_page_alone(
    browser: Any, tmp_path: Path, width: int, scheme: str
) -> None:
    """A typed box, a pasted table of T30, the form; it can be read and nothing is too wide."""
    with running(tmp_path) as server:
        visit = Visit(browser, server, width, scheme)
        page = visit.page
        lengths = {"Length x (m)": "12", "Width y (m)": "8", "Height z (m)": "4"}
        for label, value in lengths.items():
            page.get_by_label(label).fill(value)
        page.get_by_role("button", name="Use this box").press("Enter")
        page.get_by_text("can be traced").wait_for()
        visit.tab("Measurements")
        page.get_by_role("button", name=re.compile("Only decay times are known")).press("Enter")
        paste = page.get_by_text(re.compile("^or paste decay times"))
        paste.wait_for()  # a key that comes earlier closes what opens
        paste.press("Enter")
        pasted = page.get_by_role("textbox", name=re.compile("^or paste decay times"))
        use = page.get_by_role("button", name="Use the pasted table").last
        pasted.fill("place\t500 Hz\t1 kHz\nfront\tlong\n")
        use.press("Enter")
        page.get_by_text("pasted.csv, line 2, column 2").wait_for()
        assert not (tmp_path / "decay-times").exists()
        pasted.fill("place\t500 Hz\t1 kHz\t2 kHz\nfront\t1,3\t1,2\t1,1\nrear\t1,4\t1,2\t1,2\n")
        use.press("Enter")
        page.get_by_text("decay-times/pasted.csv is used").wait_for()
        visit.is_readable()
        visit.tab("Identify")
        page.frame_locator("iframe").get_by_text("Eyring").first.wait_for()
        assert not page.get_by_role("button", name=re.compile("First answer")).count()
        visit.is_readable()
        visit.tab("What if")
        # of two positions, 500 Hz and 1 kHz: 1.35 and 1.20 s
        page.locator(".answer").get_by_text("measured 1.27 s").wait_for()
        page.get_by_role("img", name="Decay times over frequency").wait_for()
        slider = page.get_by_label("Absorption of ceiling at 1 kHz")
        choose(page, "Material", "ceiling")
        slider.press("End")
        page.get_by_text("From decay times alone, 1 material changed").wait_for()
        page.locator(".answer").get_by_text("after the change").first.wait_for()
        visit.is_readable()
        page.get_by_role("checkbox", name="ceiling, 96.0 m²").press("Space")
        page.get_by_label("Free area of ceiling in m²").fill("70")
        page.get_by_label("Add a product (search the catalogue)").fill("mineral-wool-50")
        page.get_by_role("option", name=re.compile("^mineral-wool-50-mm")).click()
        page.get_by_label("Piece of mineral-wool-50-mm in m²").fill("0.72")
        page.get_by_label("At most, target 1").fill("0.8")
        visit.is_readable()
        page.get_by_role("button", name=re.compile("^Search for the cheapest")).press("Enter")
        sentence = re.compile(r"^[\d.]+ m² mineral-wool-50-mm on ceiling: T30")
        shown = page.frame_locator("iframe[title=Treatment]").get_by_text(sentence)
        shown.wait_for(timeout=_MINUTES_MS)
        visit.is_readable()
        assert not visit.foreign and not [e for e in visit.errors if "400 (Bad" not in e]
        visit.context.close()
