"""The live page in headless Chromium, in front of a simulated board. Start it with tests/page/run."""

import csv
import math
import os
import pathlib
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import unittest

from playwright.sync_api import sync_playwright

URL = os.environ.get("SLITPOSE_LIVE_URL")
PROGRAM = os.environ.get("SLITPOSE")
PICTURES = pathlib.Path(os.environ["PICTURES"])
# The page promises two seconds; the rest is for Chromium on a busy machine.
RECOVERY_MS = 2000
PATIENCE_MS = 20000

POSE = "[...document.querySelectorAll('#pose tbody tr td:nth-child(2)')].map(e => e.textContent).join()"
IS_CONNECTED = "document.getElementById('link-state').textContent.includes('connected')" \
    " && !document.getElementById('link-state').textContent.includes('dis')"
# Pixels that are drawn and not of one colour: a grid alone has few.
INK = """canvas => {
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  const colours = new Map();
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 60) continue;
    const key = (data[i] >> 4) << 8 | (data[i + 1] >> 4) << 4 | data[i + 2] >> 4;
    colours.set(key, (colours.get(key) ?? 0) + 1);
  }
  return [...colours.values()].filter(n => n > 20).length;
}"""
FRAMES = """seconds => new Promise(done => {
  let [frames, since] = [0, performance.now()];
  const count = now => {
    frames++;
    if (now - since < seconds * 1000) requestAnimationFrame(count);
    else done(frames / (now - since) * 1000);
  };
  requestAnimationFrame(count);
})"""


def wait(page, condition, patience_s=PATIENCE_MS / 1000):
    """Until an expression is true. Playwright's own way needs eval, which the page's security policy forbids."""
    end = time.monotonic() + patience_s
    while not page.evaluate(condition):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        page.wait_for_timeout(20)


class Daemon:
    """A daemon, of a simulated board unless told otherwise; `address` is where its page is."""

    def __init__(self, *arguments, address="127.0.0.1:0"):
        arguments = arguments or ("run", "--device", "sim")
        command = [PROGRAM, *arguments, "--format", "none", "--live", address]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.url, said = None, []
        for line in self.process.stderr:
            said.append(line)
            if found := re.search(r"live page at (http://\S+)", line):
                self.url = found[1]
                break
        if not self.url:
            raise RuntimeError(f"no live page: {''.join(said)}")
        # Nobody may stop the daemon by not reading what it says.
        threading.Thread(target=self.process.stderr.read, daemon=True).start()

    @property
    def address(self):
        return re.match(r"http://([^/]+)/", self.url)[1]

    def signal(self, number):
        self.process.send_signal(number)

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stderr.close()


class InBrowser(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        PICTURES.mkdir(parents=True, exist_ok=True)
        cls.playwright = sync_playwright().start()
        cls.addClassCleanup(cls.playwright.stop)
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        cls.browser = cls.playwright.chromium.launch(executable_path=os.environ["CHROMIUM"], args=arguments)
        cls.addClassCleanup(cls.browser.close)

    def setUp(self):
        self.daemon = None if URL else Daemon(*self.arguments())
        if self.daemon:
            self.addCleanup(lambda: self.daemon.end())
        self.errors = []
        self.page = self.open()

    def arguments(self):
        """What the daemon does, unless it runs a simulated board."""
        return ()

    def open(self, **options):
        page = self.browser.new_page(**{"viewport": {"width": 1400, "height": 900}, **options})
        self.addCleanup(page.close)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda line: self.note(line))
        page.goto(URL or self.daemon.url)
        wait(page, f"{IS_CONNECTED} && /[0-9]/.test({POSE})")
        return page

    def note(self, line):
        # Lost and refused connections are what a test of a restart is about.
        if line.type == "error" and "ERR_CONNECTION_" not in line.text:
            self.errors.append(line.text)

    def tearDown(self):
        self.page.screenshot(path=PICTURES / f"{self._testMethodName}.png")
        self.assertEqual(self.errors, [])

    def needs_daemon(self):
        if URL:
            self.skipTest("SLITPOSE_LIVE_URL: this daemon is not ours to stop")


class Page(InBrowser):
    def moves(self):
        """Waits until the pose shown changes; the time that it took, milliseconds."""
        since, before = time.monotonic(), self.page.evaluate(POSE)
        wait(self.page, f"{IS_CONNECTED} && {POSE} !== {before!r}")
        return (time.monotonic() - since) * 1000

    def test_the_pose_moves_and_nothing_is_blank(self):
        self.moves()
        strips = self.page.locator(".strip")
        self.assertEqual(strips.count(), 6)
        for strip in strips.all():
            self.assertRegex(strip.locator(".number").inner_text(), r"\d mm")
            self.assertIn("used", strip.locator(".states").inner_text())
        for canvas in self.page.locator("#view, .plot canvas, .strip canvas:not(.swatch)").all():
            # A busy machine draws late.
            since = time.monotonic()
            while canvas.evaluate(INK) <= 2:
                self.assertLess(time.monotonic() - since, 30, "a canvas stays blank")
                self.page.wait_for_timeout(100)

    def test_a_phone_sees_all_without_scrolling_sideways(self):
        for scheme in ["light", "dark"]:
            page = self.open(viewport={"width": 360, "height": 780}, color_scheme=scheme, has_touch=True)
            page.wait_for_timeout(1000)
            self.assertLessEqual(page.evaluate("document.documentElement.scrollWidth"), 360)
            page.screenshot(path=PICTURES / f"phone-{scheme}.png", full_page=True)

    def test_a_desk_is_filled_and_no_plot_is_small(self):
        height = "document.documentElement.scrollHeight"
        for size, scheme in [((1920, 1080), "light"), ((1280, 800), "dark"), ((390, 844), "light")]:
            page = self.open(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
            page.wait_for_timeout(11000 if size[0] == 1920 else 2000)
            plots = [plot.bounding_box() for plot in page.locator(".plot canvas").all()]
            self.assertTrue(all(box["width"] > 250 and box["height"] > 110 for box in plots), f"{size}: {plots}")
            self.assertLessEqual(page.evaluate("document.documentElement.scrollWidth"), size[0])
            if size[0] == 1920:
                self.assertLess(page.evaluate(height), 1.1 * size[1])
                panels = [page.locator(f"#{name}-panel").bounding_box() for name in ["finding", "plot", "daemon"]]
                ends = [box["y"] + box["height"] for box in panels]
                self.assertLess(max(ends) - min(ends), 10, "columns end together")
            page.screenshot(path=PICTURES / ("live.png" if size[0] == 1920 else f"live-{size[0]}.png"))
            page.close()

    def test_a_pause_holds_the_page_and_live_returns(self):
        self.page.wait_for_timeout(1000)
        self.page.keyboard.press("Space")
        self.page.keyboard.press(",")
        self.page.wait_for_timeout(300)
        held = self.page.evaluate(POSE)
        self.page.wait_for_timeout(700)
        self.assertEqual(self.page.evaluate(POSE), held)
        self.page.keyboard.press(",")
        self.page.wait_for_timeout(200)
        self.assertNotEqual(self.page.evaluate(POSE), held)
        self.page.keyboard.press("l")
        self.moves()

    def test_keys_move_the_camera(self):
        self.page.keyboard.press("Space")
        self.page.locator("#view").focus()
        picture = "document.getElementById('view').toDataURL()"
        self.page.wait_for_timeout(300)
        before = self.page.evaluate(picture)
        for key in ["ArrowLeft", "+", "2"]:
            self.page.keyboard.press(key)
            self.page.wait_for_timeout(100)
            after = self.page.evaluate(picture)
            self.assertNotEqual(after, before, key)
            before = after

    def test_a_restarted_daemon_is_shown_again(self):
        self.needs_daemon()
        address = self.daemon.address
        self.daemon.end()
        wait(self.page, "!document.getElementById('banner').hidden")
        self.page.wait_for_timeout(3000)
        self.daemon = Daemon(address=address)
        if "#" in self.daemon.url:
            # Its token is new, too; a fragment does not load the page again.
            self.page.goto(self.daemon.url)
        self.assertLess(self.moves(), RECOVERY_MS)
        wait(self.page, "document.getElementById('banner').hidden")

    def test_a_stalled_daemon_is_noticed_and_shown_again(self):
        self.needs_daemon()
        self.daemon.signal(signal.SIGSTOP)
        wait(self.page, "!document.getElementById('banner').hidden")
        self.daemon.signal(signal.SIGCONT)
        self.assertLess(self.moves(), RECOVERY_MS)

    def test_a_frozen_page_goes_on(self):
        session = self.page.context.new_cdp_session(self.page)
        session.send("Debugger.enable")
        session.send("Debugger.pause")
        time.sleep(5)
        session.send("Debugger.disable")
        self.assertLess(self.moves(), RECOVERY_MS)

    def test_frames_a_second(self):
        self.page.wait_for_timeout(2000)
        session = self.page.context.new_cdp_session(self.page)
        session.send("Performance.enable")
        read = lambda: {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
        before = read()
        rate = self.page.evaluate(FRAMES, 5)
        after = read()
        cost = {name: (after[name] - before[name]) / (5 * rate) * 1e3 for name in ["ScriptDuration", "TaskDuration"]}
        heap = after["JSHeapUsedSize"] / 1e6
        print(f"\n{rate:.1f} frames/s, {cost['ScriptDuration']:.2f} ms of scripts and {cost['TaskDuration']:.2f} ms of"
              f" all tasks a frame, {heap:.1f} MB of heap", flush=True)
        # Scripts must leave half of a frame of 60 frames/s free; the rate itself is the machine's.
        self.assertLess(cost["ScriptDuration"], 8)

    def span(self):
        return float(self.page.locator("#span").input_value())

    def test_plots_zoom_pan_measure_and_keep_their_state(self):
        page = self.page
        # Poses in the middle of the plots.
        page.wait_for_timeout(6000)
        plot = page.locator(".plot canvas").first
        box = plot.bounding_box()
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.move(*middle)
        wait(page, "document.getElementById('instant').textContent.includes('(board ')")
        self.assertRegex(page.locator(".plot .number").first.inner_text(), r"^[+−]\d.* ± 0\.0\d+ +\[.* … .*\]$")
        page.mouse.wheel(0, -400)
        wait(page, "Number(document.getElementById('span').value) < 10")
        self.assertTrue(page.locator("#follow").is_hidden(), "zoomed about the newest")
        page.mouse.down()
        page.mouse.move(middle[0] + 80, middle[1], steps=4)
        page.mouse.up()
        wait(page, "!document.getElementById('follow').hidden")
        pointed = page.locator(".plot .number").first.inner_text()
        page.wait_for_timeout(700)
        self.assertEqual(page.locator(".plot .number").first.inner_text(), pointed, "held")
        page.keyboard.down("Shift")
        page.mouse.move(middle[0] - 60, middle[1])
        page.mouse.down()
        page.mouse.move(middle[0] + 60, middle[1], steps=4)
        page.mouse.up()
        page.keyboard.up("Shift")
        words = "document.getElementById('figures-words').textContent"
        wait(page, f"{words}.includes('scans with a value')")
        expected = self.span() * 120 / (box["width"] - 46)
        shown = lambda: float(re.search(r"B − A ([\d.]+) s", page.evaluate(words))[1])
        self.assertAlmostEqual(shown(), expected, delta=0.02 * expected)
        # The marker at the right, by its line.
        page.mouse.move(middle[0] + 60, middle[1])
        page.mouse.down()
        page.mouse.move(middle[0] + 90, middle[1], steps=3)
        page.mouse.up()
        page.wait_for_timeout(100)
        self.assertAlmostEqual(shown(), expected * 1.25, delta=0.03 * expected)
        page.locator("#mode").select_option("allan")
        page.reload()
        wait(page, f"{words}.includes('scans with a value')")
        self.assertAlmostEqual(shown(), expected * 1.25, delta=0.03 * expected)
        self.assertEqual(page.locator("#mode").input_value(), "allan")
        page.locator("#mode").select_option("time")
        # A click is a moment of the whole page.
        page.mouse.click(*middle)
        wait(page, "document.getElementById('badges').textContent.includes('paused')")
        page.locator("#plots").focus()
        page.keyboard.press("Escape")
        wait(page, "document.getElementById('figures').hidden")
        span_s = self.span()
        page.keyboard.press("-")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("[")
        wait(page, "!document.getElementById('figures').hidden")
        self.assertAlmostEqual(self.span(), span_s * 1.5, delta=0.02 * span_s)
        page.keyboard.press("l")
        self.moves()
        wait(page, "document.getElementById('follow').hidden")

    def test_fingers_zoom_and_pan_the_plots(self):
        page = self.open(viewport={"width": 390, "height": 844}, has_touch=True)
        page.wait_for_timeout(1000)
        page.locator(".plot canvas").first.scroll_into_view_if_needed()
        box = page.locator(".plot canvas").first.bounding_box()
        session = page.context.new_cdp_session(page)
        at = lambda *xs: [{"x": box["x"] + x, "y": box["y"] + 40, "id": i} for i, x in enumerate(xs)]
        touch = lambda kind, *xs: session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at(*xs)})
        span = "Number(document.getElementById('span').value)"
        before = page.evaluate(span)
        touch("touchStart", 150, 200)
        for apart in range(10, 100, 10):
            touch("touchMove", 150 - apart, 200 + apart)
        touch("touchEnd")
        wait(page, f"{span} < {before / 3}")
        touch("touchStart", 150)
        for x in range(160, 260, 10):
            touch("touchMove", x)
        touch("touchEnd")
        wait(page, "!document.getElementById('follow').hidden")

    def test_twenty_pages_at_once(self):
        self.needs_daemon()
        self.page.wait_for_timeout(2000)
        ticks = lambda: sum(map(int, pathlib.Path(f"/proc/{self.daemon.process.pid}/stat").read_text().rsplit(")")[1].split()[11:13]))
        share = lambda since, before: (ticks() - before) / os.sysconf("SC_CLK_TCK") / (time.monotonic() - since) * 100
        since, before = time.monotonic(), ticks()
        self.page.wait_for_timeout(4000)
        one = share(since, before)
        pages = [self.page, *(self.open() for _ in range(19))]
        since, before = time.monotonic(), ticks()
        for page in pages:
            pose = page.evaluate(POSE)
            wait(page, f"{IS_CONNECTED} && {POSE} !== {pose!r}", 120)
        self.page.wait_for_timeout(4000)
        print(f"\ndaemon: {one:.1f} % of a core with one page, {share(since, before):.1f} % with twenty", flush=True)

    def test_what_was_wrong_is_said_for_a_while(self):
        self.needs_daemon()
        self.moves()
        self.daemon.signal(signal.SIGSTOP)
        time.sleep(0.6)
        self.daemon.signal(signal.SIGCONT)
        text = "document.getElementById('findings').textContent"
        wait(self.page, f"{text}.includes('older than') || {text}.includes('skipped')")
        self.page.wait_for_timeout(5000)
        self.assertNotIn("Nothing is wrong", self.page.evaluate(text))


class Recordings(InBrowser):
    def arguments(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        return ("run", "--device", "sim", "--record", self.folder / "first.mcap")

    def test_a_recording_is_noted_listed_renamed_fetched_and_replayed(self):
        self.needs_daemon()
        page = self.page
        wait(page, "document.getElementById('recording').textContent.includes('first.mcap')")
        page.fill("#note-text", "contact <b>now</b>")
        page.keyboard.press("Enter")
        wait(page, "document.getElementById('noted').textContent.includes('contact')")
        page.wait_for_timeout(1000)
        page.click("#record")
        wait(page, "!document.getElementById('recording').textContent || document.getElementById('record').textContent.includes('● Record')")
        page.click("#show-recordings")
        row = page.locator("#recordings-rows tr")
        cells = "[...document.querySelectorAll('#recordings-rows tr')].map(e => e.innerText).join()"
        # The summary of the file is its end.
        end = time.monotonic() + PATIENCE_MS / 1000
        while "0:0" not in page.evaluate(cells):
            self.assertLess(time.monotonic(), end, page.evaluate(cells))
            page.click("#list-again")
            page.wait_for_timeout(100)
        page.screenshot(path=PICTURES / "recordings.png")
        row.get_by_text("Rename").click()
        page.keyboard.type("contact 1")
        page.keyboard.press("Enter")
        wait(page, f"{cells}.includes('contact 1.mcap')")
        self.assertEqual([path.name for path in self.folder.iterdir()], ["contact 1.mcap"])
        # A name that is taken by nothing else, but is no capture's.
        row.get_by_text("Rename").click()
        page.keyboard.press("Control+A")
        page.keyboard.type("../x.mcap")
        page.keyboard.press("Enter")
        wait(page, "document.getElementById('banner').textContent.includes('is no name of a capture')")
        with page.expect_download() as download:
            row.get_by_text("Download").click()
        self.assertEqual(download.value.suggested_filename, "contact 1.mcap")
        fetched = pathlib.Path(download.value.path()).read_bytes()
        self.assertEqual(fetched, (self.folder / "contact 1.mcap").read_bytes())
        with page.context.expect_page() as opened:
            row.get_by_text("Replay").click()
        replay = opened.value
        replay.on("pageerror", lambda error: self.errors.append(str(error)))
        wait(replay, f"{IS_CONNECTED} && /[0-9]/.test({POSE})")
        wait(replay, "document.getElementById('notes').textContent.includes('contact <b>now</b>')")
        self.assertIn("contact 1.mcap", replay.locator("#capture").text_content())
        replay.screenshot(path=PICTURES / "replay-noted.png")
        replay.click("#notes button")
        replay.click("#play")
        wait(replay, "document.getElementById('play').textContent.includes('▶')")
        # The daemon's own page goes on meanwhile.
        page.keyboard.press("Escape")
        before = page.evaluate(POSE)
        wait(page, f"{POSE} !== {before!r}")
        replay.close()


class Session(InBrowser):
    """A session without an instrument, on a simulated head whose parts are not as its scene says."""

    SEED, FREE_S, TURN_S, REST_S, WAY_S, STEPS, STOPS = "7", 24, 20, 2, 1, 9, 6
    BOARD_S = """parseFloat([...document.querySelectorAll('#pose-facts dt')]
        .find(dt => dt.textContent === 'Board time').nextElementSibling.textContent)"""

    def arguments(self):
        self.folder = pathlib.Path(tempfile.mkdtemp())
        self.addCleanup(shutil.rmtree, self.folder)
        scene = self.folder / "head.toml"
        scene.write_text(subprocess.check_output([PROGRAM, "scene", "show", "wide"], text=True) + "[tolerance]\n")
        bench = ("bench", scene, "--output", self.folder / "bench", "--seed", self.SEED, "--duration", f"{self.FREE_S}s")
        subprocess.run([PROGRAM, *bench], check=True, stderr=subprocess.DEVNULL)
        return ("run", "--device", "sim", "--scene", scene, "--drawn", self.SEED, "--trajectory",
                self.folder / "bench/session.csv", "--record", self.folder / "all.mcap")

    def until(self, board_s):
        wait(self.page, f"{self.BOARD_S} > {board_s}", 60)

    def part(self, end_s, marks=()):
        """Records a part until `end_s` of the board, and presses the button at the instants `marks`."""
        page = self.page
        page.click("#guide-begin")
        wait(page, "document.getElementById('guide-begin').textContent.includes('End') && !document.getElementById('guide-begin').disabled")
        for mark_s in marks:
            self.until(mark_s)
            page.click("#guide-mark")
        self.until(end_s)
        advice = page.inner_text("#guide-advice")
        page.screenshot(path=PICTURES / f"guide-{page.inner_text('#guide-parts [aria-pressed=true]')[3:6]}.png")
        page.click("#guide-begin")
        wait(page, "!document.getElementById('guide-begin').textContent.includes('End')")
        return advice

    def test_a_head_is_calibrated_as_the_page_leads(self):
        page = self.page
        if page.inner_text("#record").startswith("■"):
            page.click("#record")
            wait(page, "document.getElementById('record').textContent.startsWith('●')")
        page.click("#open-guide")
        self.assertTrue(page.is_disabled("#guide-adjust"), "nothing is recorded yet")
        self.assertIn("That is enough", self.part(self.FREE_S - 0.2))
        turned_s = self.FREE_S + self.WAY_S
        self.until(turned_s)
        self.assertRegex(self.part(turned_s + self.TURN_S - 1), "That is enough|Go on for")
        rests_s = [turned_s + self.TURN_S + self.WAY_S + k * (self.REST_S + self.WAY_S) for k in range(self.STEPS + 2 * self.STOPS)]
        step_mm = self.step_mm(rests_s)
        page.fill("#guide-step", step_mm)
        self.part(rests_s[self.STEPS - 1] + self.REST_S, [at + 1.6 for at in rests_s[:self.STEPS]])
        # Every other rest is at the stop.
        stops_s = rests_s[self.STEPS + 1::2]
        self.assertIn("That is enough", self.part(stops_s[-1] + self.REST_S, [at + 1.6 for at in stops_s]))
        page.click("#guide-adjust")
        wait(page, "document.getElementById('guide-result').textContent.includes('wrote')", 900)
        said = page.inner_text("#guide-result")
        page.screenshot(path=PICTURES / "guide-result.png")
        known_um = float(re.search(r"known to ([0-9.]+) µm", said)[1])
        self.assertLess(known_um, 5, said)
        self.assertNotIn("the scale of translations", said)
        calibration = next(self.folder.glob("calibration-*.toml"))
        self.assert_calibrated(calibration)
        self.assertEqual(self.errors, [])

    def step_mm(self, rests_s):
        """The length of a step, as the operator reads it off the stage."""
        with open(self.folder / "bench/session.csv") as table:
            rows = {float(row["time_s"]): row for row in csv.DictReader(table)}
        first, last = (rows[rests_s[k]] for k in (0, self.STEPS - 1))
        ends = [[float(row[f"t{axis}_mm"]) for axis in "xyz"] for row in (first, last)]
        return f"{math.dist(*ends) / (self.STEPS - 1):.9f}"

    def assert_calibrated(self, calibration):
        """Poses of the head differ from the truth as frames do, and by a few micrometres besides."""
        poses = self.folder / "poses.csv"
        quiet = self.folder / "bench/test_quiet.csv"
        subprocess.run([PROGRAM, "solve", self.folder / "head.toml", "--currents", quiet, "--calibration", calibration,
                        "--output", poses], check=True, stderr=subprocess.DEVNULL)
        with open(poses) as found, open(self.folder / "bench/truth/test_quiet.csv") as truth:
            pairs = zip(csv.DictReader(found), csv.DictReader(truth))
            apart = [[1e3 * (float(row[f"t{axis}_mm"]) - float(true[f"t{axis}_mm"])) for axis in "xyz"] for row, true in pairs]
        mean = [sum(column) / len(apart) for column in zip(*apart)]
        rms_um = math.sqrt(sum(math.dist(error, mean) ** 2 for error in apart) / len(apart))
        print(f"poses differ by {math.hypot(*mean):.0f} µm in the mean, and by {rms_um:.1f} µm rms around it")
        # Uncalibrated, some 500 µm. Frames that are turned by a milliradian or two leave 10 µm at 5 mm.
        self.assertLess(rms_um, 40)


class Sine(InBrowser):
    """A tool that shakes at 19 Hz, which pages at 60 frames a second cannot sample."""

    HZ, AMPLITUDE_MM, LENGTH_S = 19, 2.0, 603

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        if URL:
            raise unittest.SkipTest("SLITPOSE_LIVE_URL: it does not replay this motion")
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        scene = subprocess.run([PROGRAM, "scene", "show", "wide"], capture_output=True, text=True, check=True).stdout
        (cls.folder / "scene.toml").write_text(re.sub(r"frame_rate_hz = \d+", "frame_rate_hz = 1000", scene))
        with open(cls.folder / "motion.csv", "w") as table:
            table.write("time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n")
            for row in range(cls.LENGTH_S * 1000):
                x = cls.AMPLITUDE_MM * math.sin(2 * math.pi * cls.HZ * row / 1000)
                table.write(f"{row / 1000},{x:.6f},0,0,0,0,0\n")
        subprocess.run([PROGRAM, "simulate", "--scene", cls.folder / "scene.toml", "--trajectory",
                        cls.folder / "motion.csv", "--duration", f"{cls.LENGTH_S}s", "--tier", "paper",
                        "--output", cls.folder / "sine.mcap"], check=True)

    def arguments(self):
        return ("replay", str(self.folder / "sine.mcap"))

    def is_right(self, figure, expected):
        self.assertAlmostEqual(figure, expected, delta=0.01 * abs(expected))

    def check(self, spans_s):
        """At each span: the least and greatest value of all columns, and the figures between markers at its ends."""
        page = self.page
        box = page.locator(".plot canvas").first.bounding_box()
        left, width = box["x"] + 46, box["width"] - 46
        for span_s in spans_s:
            page.locator("#span").select_option(str(span_s))
            ends = []
            has_periods = span_s / width * self.HZ > 2
            for step in range(1, 25 if has_periods else 130):
                page.mouse.move(left + width * step / (25 if has_periods else 130), box["y"] + 20)
                page.wait_for_timeout(40)
                text = page.locator(".plot .number").first.inner_text().replace("−", "-")
                ends += [float(number) for number in re.search(r"\[(\S+) … (\S+)\]", text).groups()]
                if has_periods:
                    self.is_right(ends[-2], -self.AMPLITUDE_MM)
                    self.is_right(ends[-1], self.AMPLITUDE_MM)
            self.is_right(min(ends), -self.AMPLITUDE_MM)
            self.is_right(max(ends), self.AMPLITUDE_MM)
            page.locator("#plots").focus()
            for place, key in [(left + 1, "["), (left + width - 1, "]")]:
                page.mouse.move(place, box["y"] + 20)
                page.keyboard.press(key)
            page.wait_for_timeout(200)
            figures = page.locator("#figures tbody tr").first.locator("td").all_inner_texts()
            mean, rms, peak_to_peak = [float(figure.replace("−", "-")) for figure in figures[-3:]]
            print(f"\n{span_s} s: columns {min(ends):.4f} to {max(ends):.4f} mm, rms {rms:.4f}, peak to peak {peak_to_peak:.4f}", flush=True)
            self.is_right(rms, self.AMPLITUDE_MM / math.sqrt(2))
            self.is_right(peak_to_peak, 2 * self.AMPLITUDE_MM)
            # Some part of a period remains, and the last digit shown.
            self.assertLess(abs(mean), 1.1 * self.AMPLITUDE_MM / (math.pi * self.HZ * span_s) + 1e-4)
            page.keyboard.press("Escape")
            page.keyboard.press("End")

    def test_envelope_and_markers_are_right_at_every_span(self):
        page = self.page
        page.wait_for_timeout(6000)
        page.keyboard.press("p")
        page.wait_for_timeout(500)
        self.check([0.5, 1, 2, 5])
        page.locator("#mode").select_option("spectrum")
        wait(page, "document.querySelector('.plot .number').textContent.includes('strongest')")
        hz, mm = re.search(r"strongest ([\d.]+) Hz, ([\d.]+) mm", page.locator(".plot .number").first.inner_text()).groups()
        self.is_right(float(hz), self.HZ)
        self.is_right(float(mm), self.AMPLITUDE_MM)
        page.locator("#mode").select_option("time")
        page.locator("#speed").select_option("max")
        page.keyboard.press("p")
        wait(page, "document.getElementById('capture').textContent.includes('at its end')", 240)
        self.check([0.5, 10, 20, 30, 60, 120, 300, 600])


if __name__ == "__main__":
    unittest.main()
