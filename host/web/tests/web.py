"""The page without a server in headless Chromium. Start it with host/web/run."""

import base64
import hashlib
import http.server
import os
import pathlib
import random
import re
import subprocess
import tempfile
import threading
import time
import tty
import unittest

from axe_playwright_python.sync_playwright import Axe
from browser import FRAMES, INK, PICTURES, POSE, PROGRAM, wait
from playwright.sync_api import sync_playwright

FOLDER = os.environ["SLITPOSE_WEB"]
EMULATOR = os.environ["SLITPOSE_EMULATOR"]
SCANS = int(os.environ.get("SLITPOSE_SCANS", 20_000))
HERE = pathlib.Path(__file__).parent
ROOT = HERE.parents[2]
HAS_POSE = f"/[0-9]/.test({POSE})"
FACT = """name => [...document.querySelectorAll('#facts dt')].find(e => e.textContent === name)
  ?.nextElementSibling.textContent ?? ''"""


class Handler(http.server.SimpleHTTPRequestHandler):
    def __init__(self, *arguments):
        super().__init__(*arguments, directory=FOLDER)

    def log_message(self, *_):
        pass


class InBrowser(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        PICTURES.mkdir(parents=True, exist_ok=True)
        cls.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=cls.server.serve_forever, daemon=True).start()
        cls.addClassCleanup(cls.server.server_close)
        cls.addClassCleanup(cls.server.shutdown)
        cls.playwright = sync_playwright().start()
        cls.addClassCleanup(cls.playwright.stop)
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        cls.browser = cls.playwright.chromium.launch(executable_path=os.environ["CHROMIUM"], args=arguments)
        cls.addClassCleanup(cls.browser.close)

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.errors = []

    def open(self, script=None, width=1400, height=900, **options):
        self.context = self.browser.new_context(viewport={"width": width, "height": height}, **options)
        self.addCleanup(self.context.close)
        page = self.context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda line: line.type == "error" and self.errors.append(line.text))
        if script:
            page.add_init_script(script)
        page.goto(f"http://127.0.0.1:{self.server.server_port}/")
        return page

    def tearDown(self):
        self.assertEqual(self.errors, [])

    def slitpose(self, *arguments, code=0):
        done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, cwd=self.folder)
        self.assertEqual(done.returncode, code, done.stderr)
        return done.stdout

    def download(self, page, act):
        with page.expect_download(timeout=600_000) as download:
            act()
        path = self.folder / f"from-page-{download.value.suggested_filename}"
        download.value.save_as(path)
        return path


# Without it recordings and tables are downloads.
NO_PICKER = "delete window.showSaveFilePicker;"


class SimulatedHead(InBrowser):
    def test_a_pose_is_there_at_once_and_the_page_draws_thirty_a_second(self):
        page = self.open()
        wait(page, HAS_POSE)
        first_ms = page.evaluate("performance.now()")
        wait(page, "document.getElementById('badges').textContent.includes('simulated')")
        page.wait_for_timeout(3000)
        before, began = worker_seconds(), time.monotonic()
        frames_hz = page.evaluate(FRAMES, 4)
        load = (worker_seconds() - before) / (time.monotonic() - began)
        rate = page.evaluate(FACT, "Rate")
        print(f"first pose after {first_ms:.0f} ms; {frames_hz:.0f} frames/s; worker {load:.0%} of a processor; {rate}")
        self.assertGreater(page.locator("#view").evaluate(INK), 6)
        page.screenshot(path=PICTURES / "web.png")
        page.locator("#sources summary").click()
        page.screenshot(path=PICTURES / "web-closed.png")

    def test_faults_motions_and_scenes_are_simulated_as_chosen(self):
        page = self.open()
        wait(page, HAS_POSE)
        page.select_option("#scene", "redundant")
        page.fill("#faults", "dead:emitter=4,from=1s")
        page.select_option("#motion", "smooth")
        page.click("#simulate")
        wait(page, "document.getElementById('scene-name').textContent.includes('nine cells')")
        wait(page, "document.getElementById('findings').textContent.includes('cell 4')", 60)
        page.fill("#faults", "nonsense:cell=2")
        page.click("#simulate")
        wait(page, "document.getElementById('source-words').textContent.includes('nonsense')")

    def test_a_phone_shows_the_same_in_a_column(self):
        page = self.open(width=390, height=844)
        wait(page, HAS_POSE)
        page.wait_for_timeout(1500)
        self.assertLessEqual(page.evaluate("document.documentElement.scrollWidth"), 390)
        page.screenshot(path=PICTURES / "web-390.png", full_page=True)

    def test_nothing_stands_in_the_way_of_anyone(self):
        for theme in ["light", "dark"]:
            page = self.open(color_scheme=theme)
            wait(page, HAS_POSE)
            page.wait_for_timeout(1000)
            found = Axe().run(page)
            told = [(rule["id"], [node["html"] for node in rule["nodes"]]) for rule in found.response["violations"]]
            self.assertEqual(told, [], f"{theme}: {told}")

    def test_it_is_shown_again_without_a_network(self):
        page = self.open()
        wait(page, HAS_POSE)
        page.evaluate("navigator.serviceWorker.ready.then(() => true)")
        wait(page, "caches.keys().then(keys => keys.length > 0)")
        page.wait_for_timeout(1000)
        self.context.set_offline(True)
        page.reload()
        wait(page, HAS_POSE)

    def test_a_scene_is_written_and_its_errors_are_at_their_place(self):
        page = self.open(NO_PICKER)
        wait(page, HAS_POSE)
        page.click("#edit-scene")
        text = page.input_value("#scene-text")
        self.assertIn("length_mm", text)
        page.fill("#scene-text", text.replace("length_mm =", "lenght_mm =", 1))
        wait(page, "document.getElementById('scene-error').textContent.includes('lenght_mm')")
        # What was there before stays.
        self.assertEqual(page.evaluate("document.body.dataset.source"), "run")
        line = 1 + text[: text.index("length_mm =")].count("\n")
        self.assertIn(f"Line {line}:", page.inner_text("#scene-error"))
        page.click("#to-error")
        at = page.evaluate("document.getElementById('scene-text').selectionStart")
        self.assertEqual(text[:at].count("\n") + 1, line)
        page.screenshot(path=PICTURES / "web-scene-error.png")
        text = text.replace("name = ", 'name = "mine, " #', 1) if "name = " in text else 'name = "mine"\n' + text
        page.fill("#scene-text", text)
        wait(page, "document.body.dataset.source === 'scene' && document.getElementById('scene-error').textContent === 'As the text says.'")
        wait(page, "document.getElementById('scene-name').textContent.includes('mine')")
        page.screenshot(path=PICTURES / "web-scene-text.png")
        saved = self.download(page, lambda: page.click("#save-scene"))
        self.assertEqual(saved.read_text(), text)
        self.slitpose("scene", "check", saved)

    def test_a_scene_is_looked_at_by_dragging_the_tool(self):
        page = self.open()
        wait(page, HAS_POSE)
        page.click("#view-scene")
        wait(page, "document.body.dataset.source === 'scene'")
        wait(page, HAS_POSE)
        page.locator("#sources summary").click()
        page.click("#map summary")
        began = time.monotonic()
        wait(page, "document.getElementById('map-words').textContent.includes('median')")
        print(f"accuracy over a plane after {time.monotonic() - began:.2f} s")
        page.select_option("#map-plane", "xz")
        wait(page, "document.getElementById('map-words').textContent.includes('z ±')")
        page.screenshot(path=PICTURES / "web-scene.png")


def worker_seconds():
    """Processor time of the workers of all pages."""
    seconds = 0.0
    for task in pathlib.Path("/proc").glob("[0-9]*/task/[0-9]*"):
        try:
            if (task / "comm").read_text().startswith("DedicatedWorker"):
                fields = (task / "stat").read_text().rsplit(")", 1)[1].split()
                seconds += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        except OSError:
            pass
    return seconds


class Board(InBrowser):
    """A board whose firmware runs in the emulator, behind a port of Web Serial."""

    def open(self, **options):
        self.emulator = subprocess.Popen([EMULATOR, "wide"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.addCleanup(self.emulator.kill)
        self.terminal, self.port = self.emulator.stdout.readline().strip(), None
        page = super().open(NO_PICKER + (HERE / "serial.js").read_text(), **options)
        return page

    def new_page_binding(self, page):
        page.expose_function("board", self.to_board)

    def to_board(self, text):
        if text == "open":
            self.port = os.open(self.terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self.port)
        elif text == "close":
            if self.port is not None:
                os.close(self.port)
            self.port = None
        elif self.port is not None:
            os.write(self.port, base64.b64decode(text))

    def pump(self, page, is_done, patience_s=300):
        """Carries bytes to the page until `is_done`."""
        end = time.monotonic() + patience_s
        while not is_done():
            self.assertLess(time.monotonic(), end, page.text_content("#banner") + page.text_content("#facts"))
            bytes_ = b""
            while self.port is not None and len(bytes_) < 1 << 15:
                try:
                    bytes_ += os.read(self.port, 4096)
                except OSError:
                    break
            if bytes_:
                page.evaluate("text => fromBoard(text)", base64.b64encode(bytes_).decode())
            page.wait_for_timeout(4)

    def test_ten_seconds_of_firmware_are_solved_recorded_and_replayed_without_a_loss(self):
        page = self.open()
        page.expose_function("board", self.to_board)
        wait(page, HAS_POSE)
        page.click("#connect")

        def scans():
            return int(re.sub(r"\D", "", page.evaluate(FACT, "Scans")) or 0)

        self.pump(page, lambda: "nucleo" in page.evaluate(FACT, "Board").lower() and scans() > 400)
        page.screenshot(path=PICTURES / "web-board.png")
        page.click("#record")
        self.pump(page, lambda: "Stop recording" in page.text_content("#record"))
        first = scans()
        self.pump(page, lambda: scans() >= first + 40_000)
        lost = [page.evaluate(FACT, f"Lost on the {place}") for place in ["board", "link"]]
        print(f"{scans()} scans; lost on board and link: {lost}")
        for words in lost:
            self.assertEqual(sum(map(int, re.findall(r"\d+", words))), 0)
        with page.expect_download() as download:
            page.click("#record")
        capture = self.folder / "board.mcap"
        download.value.save_as(capture)
        csv = self.slitpose("replay", capture, "--format", "csv")
        rows = csv.splitlines()[1:]
        sequence = csv.splitlines()[0].split(",").index("seq")
        numbers = [int(row.split(",")[sequence]) for row in rows]
        self.assertGreaterEqual(len(numbers), 40_000)
        self.assertEqual(numbers, list(range(numbers[0], numbers[0] + len(numbers))))
        print(f"{len(numbers)} of {len(numbers)} recorded scans replayed by the program")

        # Unplugged and plugged in again.
        page.evaluate("plug(false)")
        self.pump(page, lambda: "gone" in page.evaluate(FACT, "Link"))
        page.evaluate("plug(true)")
        self.pump(page, lambda: "running, 1 reconnects" in page.evaluate(FACT, "Link"))
        page.click("#disconnect")
        page.wait_for_timeout(500)
        self.assertIsNone(self.port)


class Captures(InBrowser):
    def play(self, page, *paths):
        page.set_input_files("#captures", [str(path) for path in paths])

    def test_a_capture_is_played_paused_sought_and_its_end_reached(self):
        capture = self.folder / "contact.mcap"
        self.slitpose("simulate", "--trajectory", "contact", "--duration", "8s", "--output", capture)
        page = self.open()
        wait(page, HAS_POSE)
        self.play(page, capture)
        wait(page, "document.body.dataset.source === 'replay'")
        wait(page, "document.getElementById('place').textContent.includes('/ 0:08')")
        page.click("#play")
        wait(page, "document.getElementById('play').textContent.includes('Play')")
        page.evaluate("seek.value = 5; seek.dispatchEvent(new Event('change'))")
        wait(page, "document.getElementById('place').textContent.startsWith('0:05')")
        page.select_option("#speed", "max")
        page.click("#play")
        wait(page, "document.getElementById('capture').textContent.includes('at its end')")
        page.locator("#sources summary").click()
        page.screenshot(path=PICTURES / "web-replay.png")

    def test_tables_of_random_poses_are_those_of_the_program_bit_for_bit(self):
        self.slitpose("bench", "wide", "--output", "bench")
        self.slitpose("calibrate", "wide", "--known", "bench/known.csv", "--output", "calibration.toml")
        page = self.open(NO_PICKER)
        wait(page, HAS_POSE)
        total, seconds = 0, SCANS / 4 / 4000
        heads = [("wide", []), ("wide", ["--calibration", "calibration.toml"]), ("spacemouse", []), ("maglev", [])]
        for number, (scene, more) in enumerate(heads):
            poses = self.folder / f"poses-{number}.csv"
            random_poses(poses, seconds, number, 2.5 if number < 3 else 0.4)
            capture = self.folder / f"random-{number}.mcap"
            self.slitpose("simulate", "--scene", scene, "--trajectory", poses, "--duration", f"{seconds}s", "--output", capture, *more)
            native = self.folder / f"native-{number}.csv"
            self.slitpose("export", capture, "--output", native)
            self.play(page, capture)
            wait(page, "document.body.dataset.source === 'replay'")
            wait(page, f"document.getElementById('source-name').textContent.includes('random-{number}')")
            began = time.monotonic()
            table = self.download(page, lambda: page.click("#export"))
            lasted_s = time.monotonic() - began
            rows = native.read_text().count("\n") - 1
            digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (table, native)]
            statuses = native.read_text().count("converged")
            print(f"{capture.stem}: {rows} scans, {statuses} converged, {rows / lasted_s:.0f} a second, sha256 {digests[0][:16]}")
            self.assertEqual(*digests)
            self.assertGreater(statuses, rows * 0.5)
            total += rows
        print(f"{total} poses equal to the last bit")

    def test_a_long_capture_needs_no_more_memory_than_a_short_one(self):
        capture = self.folder / "long.mcap"
        self.slitpose("simulate", "--trajectory", "smooth", "--duration", "300s", "--output", capture)
        page = self.open()
        wait(page, HAS_POSE)
        page.wait_for_timeout(2000)
        before = renderer_bytes()
        self.play(page, capture)
        wait(page, "document.body.dataset.source === 'replay'")
        wait(page, "document.getElementById('place').textContent.includes('/ 5:00')", 120)
        page.select_option("#speed", "max")
        page.wait_for_timeout(5000)
        grown = renderer_bytes() - before
        print(f"capture of {capture.stat().st_size / 1e6:.0f} MB: {grown / 1e6:+.0f} MB in the renderer")
        self.assertLess(grown, 150e6)

    def test_hostile_captures_give_a_message_and_the_page_goes_on(self):
        sound = self.folder / "sound.mcap"
        self.slitpose("simulate", "--duration", "1s", "--output", sound)
        whole = sound.read_bytes()
        chance = random.Random(1)
        hostile = {path.name: path.read_bytes() for path in (ROOT / "tests/fuzz/corpus/capture").iterdir()}
        hostile |= {
            "empty": b"",
            "text": b"hello\n" * 100,
            "zip": b"PK\x03\x04" + bytes(100),
            "zeros": bytes(1 << 20),
            "noise": chance.randbytes(1 << 20),
            "magic": whole[:8],
            "cut": whole[: len(whole) // 2],
            "flipped": bytes(byte ^ (1 << chance.randrange(8) if chance.random() < 1e-3 else 0) for byte in whole),
        }
        page = self.open()
        wait(page, HAS_POSE)
        for name, data in hostile.items():
            path = self.folder / f"{name}.mcap"
            path.write_bytes(data)
            page.set_input_files("#captures", str(path))
            said = "document.getElementById('source-words').textContent + document.getElementById('banner').textContent"
            wait(page, f"document.getElementById('source-name').textContent.includes('{name}.mcap') || {said} !== ''", 30)
            page.wait_for_timeout(700)
            print(f"{name}: {page.evaluate(said)[:150]}")
        page.screenshot(path=PICTURES / "web-hostile.png")
        page.click("#simulate")
        wait(page, "document.getElementById('badges').textContent === 'simulated'")
        wait(page, HAS_POSE)
        self.errors = [error for error in self.errors if "NotReadable" not in error]


def renderer_bytes():
    """Memory of the largest process of Chromium that renders."""
    largest = 0
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            if b"--type=renderer" in (process / "cmdline").read_bytes():
                largest = max(largest, int(re.search(r"VmRSS:\s+(\d+)", (process / "status").read_text())[1]) * 1024)
        except (OSError, TypeError):
            pass
    return largest


def random_poses(path, seconds, seed, half_mm):
    """A path through random poses, one each 25 ms."""
    chance = random.Random(seed)
    with open(path, "w") as table:
        print("time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad,id", file=table)
        for number in range(int(seconds / 0.025) + 2):
            mm = [chance.uniform(-half_mm, half_mm) for _ in range(3)]
            rad = [chance.uniform(-0.04, 0.04) * half_mm for _ in range(3)]
            print(number * 0.025, *mm, *rad, number, sep=",", file=table)


class Recordings(InBrowser):
    def test_a_recording_goes_to_the_file_that_was_chosen(self):
        # A file of the browser's own in the place of one of the user's: both are handles of one kind.
        page = self.open("""window.showSaveFilePicker = async ({ suggestedName }) =>
            (await navigator.storage.getDirectory()).getFileHandle(suggestedName, { create: true });""")
        wait(page, HAS_POSE)
        page.click("#record")
        wait(page, "document.getElementById('recording').textContent.includes('.mcap, ')")
        page.wait_for_timeout(1500)
        page.fill("#note-text", "a note")
        page.click("#note button")
        wait(page, "document.getElementById('noted').textContent.includes('a note')")
        page.wait_for_timeout(1500)
        page.click("#record")
        wait(page, "document.getElementById('record').textContent.includes('● Record')")
        page.wait_for_timeout(500)
        text = page.evaluate("""async () => {
          const folder = await navigator.storage.getDirectory();
          for await (const [name, handle] of folder) {
            const bytes = new Uint8Array(await (await handle.getFile()).arrayBuffer());
            let text = '';
            for (const byte of bytes) text += String.fromCharCode(byte);
            return btoa(text);
          }
        }""")
        capture = self.folder / "chosen.mcap"
        capture.write_bytes(base64.b64decode(text))
        rows = self.slitpose("replay", capture, "--format", "csv").count("\n") - 1
        print(f"{capture.stat().st_size} bytes, {rows} scans")
        self.assertGreater(rows, 4000)
