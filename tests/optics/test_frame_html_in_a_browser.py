"""The page of a frame in headless Chromium: what a hand on mouse, keyboard or glass sees, at two widths."""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from optics.frame_html import Marks, differences, frame_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]

WIDTH, HEIGHT = 600, 300
IMAGE = np.random.default_rng(6).integers(90, 120, (HEIGHT, WIDTH)).astype(np.uint16)
IMAGE[20, 30], IMAGE[200, 500] = 4000, 3000
LIGHT = {"light [e-]": np.array([9000.0, 7000.0])}
PLACE = {"x_px": np.array([30.25, 500.0]), "y_px": np.array([20.0, 200.0])}
TRUE = Marks(name="true stars", **PLACE, label=["2.0", "3.5"], columns=LIGHT)
MEASURED = Marks(name="measured stars", x_px=TRUE.x_px + 0.1, y_px=TRUE.y_px, shape="square", colour="#4aa3df")
PAGE = frame_page(
    IMAGE,
    [TRUE, MEASURED, differences([MEASURED], TRUE)],
    title="Two stars",
    flags={"saturated": IMAGE > 3500},
    sky=np.array([[[1.0, y, x] / np.sqrt(1 + x * x + y * y) for x in (-0.1, 0.1)] for y in (-0.05, 0.05)]),
)
# Headless and with virtual time, Chromium draws frames when it likes; timers are exact.
TIMERS = "<script>window.requestAnimationFrame = draw => setTimeout(draw, 0);</script></head>"
# What a person does, and what stands on the page then; `done` is what the test reads.
DRIVER = """
<script>
const $ = id => document.getElementById(id), stage = $("stage"), said = {};
const wait = () => new Promise(done => setTimeout(done, 50));
const finger = (type, id, x, y) => {
  const box = stage.getBoundingClientRect(), where = {clientX: box.left + x, clientY: box.top + y};
  stage.dispatchEvent(new PointerEvent(type, {pointerId: id, bubbles: true, ...where}));
};
const key = (name, more = {}) => {
  stage.dispatchEvent(new KeyboardEvent("keydown", {key: name, bubbles: true, cancelable: true, ...more}));
};
const colour = (x, y) => [...$("image").getContext("2d").getImageData(x, y, 1, 1).data].slice(0, 3);
const scale = () => Math.min(stage.clientWidth / WIDTH, stage.clientHeight / HEIGHT);
const place = (x, y) => [
  (x - (WIDTH - 1) / 2) * scale() + stage.clientWidth / 2,
  (y - (HEIGHT - 1) / 2) * scale() + stage.clientHeight / 2,
];
const details = () => $("details").innerText.split("\\n").filter(Boolean);
async function drive() { DRIVE }
const timer = setInterval(async () => {
  const root = document.documentElement;
  if (!root.classList.contains("ready") && !root.dataset.failed) return;
  clearInterval(timer);
  try { await drive(); } catch (error) { said.failed = String(error.stack); }
  if (root.dataset.failed) said.failed = root.dataset.failed;
  const text = JSON.stringify(said);
  if (parent !== window) parent.postMessage(text, "*");
  else document.body.dataset.said = text;
}, 20);
</script>
"""


def driven(tmp_path, script, *flags, page=PAGE, inside=None):
    """What the script said; ``inside``: in a frame of that width, as windows have a least width."""
    driver = DRIVER.replace("DRIVE", script).replace("WIDTH", str(WIDTH)).replace("HEIGHT", str(HEIGHT))
    page = page.replace("</head>", TIMERS).replace("</body>", f"{driver}</body>")
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    shown = tmp_path / "page.html"
    if inside is not None:
        shown = tmp_path / "around.html"
        shown.write_text(
            f'<body><iframe src="page.html" width="{inside}" height="844"></iframe>'
            "<script>onmessage = event => { document.body.dataset.said = event.data; }</script></body>"
        )
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=20000", "--window-size=1280,900", *flags, "--dump-dom", f"file://{shown}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    said = json.loads(html.unescape(re.search(r'data-said="([^"]*)"', done.stdout)[1]))
    assert "failed" not in said, said["failed"]
    return said


def test_mouse_and_keyboard_at_1280_px(tmp_path):
    said = driven(
        tmp_path,
        """
        said.overflow = document.documentElement.scrollWidth - innerWidth;
        said.nameless = [...document.querySelectorAll("button, input, select")].filter(
            one => !(one.labels && one.labels.length) && !one.textContent.trim() && !one.ariaLabel).map(one => one.id);
        said.alt = [stage.ariaLabel, $("preview").alt];
        finger("pointermove", 1, ...place(500, 200)); said.value = $("readout").textContent;
        finger("pointermove", 1, ...place(30, 20)); said.saturated = $("readout").textContent;
        const middle = place(30, 20).map(Math.round), ratio = $("image").width / stage.clientWidth;
        said.tint = colour(middle[0] * ratio, middle[1] * ratio);
        $("flag0").click(); await wait(); said.untinted = colour(middle[0] * ratio, middle[1] * ratio);
        finger("pointerdown", 1, ...place(30, 20)); finger("pointerup", 1, ...place(30, 20)); said.picked = details();
        stage.focus(); key("n"); await wait(); said.next = details(); said.focus = $("readout").textContent;
        for (let i = 0; i < 9; i++) key("+");
        await wait(); key("ArrowRight", {shiftKey: true}); await wait(); said.right = $("readout").textContent;
        key("0"); await wait(); key("1"); await wait();
        finger("pointerdown", 1, 200, 100); finger("pointermove", 1, 220, 90); finger("pointerup", 1, 220, 90);
        said.rows = $("rows").children.length; said.heads = $("heads").innerText;
        $("listed").value = "1"; $("listed").dispatchEvent(new Event("change")); said.second = $("rows").innerText;
        said.layers = $("layers").innerText.split("\\n").map(one => one.trim()).filter(Boolean);
        """,
    )
    assert said["overflow"] <= 0
    assert said["nameless"] == []
    assert said["alt"] == ["Two stars: image of 600 by 300 pixels, 2 true stars, 2 measured stars"] * 2
    assert said["value"].startswith(f"x 500, y 200: {IMAGE[200, 500]} DN · RA ")
    assert said["saturated"].startswith("x 30, y 20: 4000 DN (saturated)")
    assert said["tint"] == [255, 77, 109]
    assert said["untinted"] == [255, 255, 255]
    assert said["picked"][0] == "true stars 2.0"
    assert said["next"][0] == "true stars 3.5"
    assert said["focus"].startswith(f"x 500, y 200: {IMAGE[200, 500]} DN")
    assert said["right"].startswith(f"x 501, y 200: {IMAGE[200, 501]} DN")
    assert said["rows"] == 2
    assert "light [e-]" in said["heads"]
    assert "30.35" in said["second"]
    assert said["layers"][1:7] == ["true stars", "2", "measured stars", "2", "errors against true stars", "2"]


def test_direction_under_the_cursor(tmp_path):
    said = driven(tmp_path, "finger('pointermove', 1, ...place(449.5, 149.5)); said.there = $('readout').textContent;")
    ra, dec = map(float, re.search(r"RA ([\d.]+)°, Dec ([−\d.]+)°", said["there"].replace("−", "-")).groups())
    # in the middle of the rows and three quarters along the columns of a flat field of tangents -0.1 to 0.1
    assert (ra, dec) == (pytest.approx(0.0, abs=2e-4), pytest.approx(np.degrees(np.arctan(0.05)), abs=2e-2))


def test_touch_in_the_dark_at_390_px(tmp_path):
    said = driven(
        tmp_path,
        """
        said.width = innerWidth; said.overflow = document.documentElement.scrollWidth - innerWidth;
        said.paper = getComputedStyle(document.documentElement).backgroundColor;
        said.small = [...document.querySelectorAll("button")].filter(one => one.offsetHeight < 44).length;
        const [x, y] = place(500, 200);
        finger("pointerdown", 1, x - 20, y); finger("pointerdown", 2, x + 20, y);
        finger("pointermove", 1, x - 80, y); finger("pointermove", 2, x + 80, y);
        finger("pointerup", 1, x - 80, y); finger("pointerup", 2, x + 80, y); await wait();
        finger("pointermove", 3, x, y); said.same = $("readout").textContent;
        finger("pointermove", 3, x + 2.2 * scale(), y); said.beside = $("readout").textContent;
        """,
        "--force-dark-mode",
        "--blink-settings=preferredColorScheme=0",
        inside=390,
    )
    assert said["width"] == 390
    assert said["overflow"] <= 0
    assert max(map(int, re.findall(r"\d+", said["paper"])[:3])) < 60
    assert said["small"] == 0
    assert said["same"].startswith(f"x 500, y 200: {IMAGE[200, 500]} DN")  # what lies between the fingers stays
    assert said["beside"].startswith("x 501, y 200:")  # four times as large: 2.2 pixels of before are half a pixel


def test_print(tmp_path):
    (tmp_path / "page.html").write_text(PAGE, encoding="utf-8")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=9000", f"--print-to-pdf={tmp_path / 'page.pdf'}"]
    subprocess.run([*command, f"file://{tmp_path / 'page.html'}"], capture_output=True, check=True, timeout=120)
    content = (tmp_path / "page.pdf").read_bytes()
    assert content.count(b"/Type /Page\n") == 1
    assert b"/Subtype /Image" in content
