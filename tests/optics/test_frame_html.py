"""The page of a frame: exact pixels, marks where they belong, nothing from elsewhere."""

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from optics.frame_html import Marks, differences, frame_page, save_frame_page


class Parts(HTMLParser):
    """Texts of the scripts by id, and every attribute there is."""

    def __init__(self, page):
        super().__init__()
        self.script, self.attributes, self._at = {}, [], None
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, *one) for one in attrs]
        self._at = dict(attrs).get("id", "program") if tag == "script" else None

    def handle_data(self, data):
        if self._at:
            self.script[self._at] = self.script.get(self._at, "") + data

    def handle_endtag(self, tag):
        self._at = None


def decoded(page):
    """Pixels of a page, by the rule that stands in its program: zero + step * sum of bytes * 256^plane."""
    parts = Parts(page)
    meta = json.loads(parts.script["meta"])
    raw = np.frombuffer(zlib.decompress(base64.b64decode(parts.script["pixels"])), np.uint8)
    planes = raw.reshape(meta["planes"], meta["height"], meta["width"]).astype(np.int64)
    number = sum(plane * 256**at for at, plane in enumerate(planes))
    return meta["zero"] + meta["step"] * number, meta, parts


def marks(n=3, **settings):
    x_px = np.arange(n, dtype=float)
    return Marks(**{"name": "stars", "x_px": x_px, "y_px": 2 * x_px, **settings})


@pytest.mark.parametrize(
    "image",
    [
        np.random.default_rng(1).integers(0, 65536, (31, 40)).astype(np.uint16),
        np.random.default_rng(2).integers(90, 110, (8, 5)),
        np.array([[-70000, 3], [70000, 5]]),
        np.array([[7.0, 7.0]]),
        np.array([[2**31, 0]]),
    ],
    ids=["16 bits", "noise", "negative", "constant", "32 bits"],
)
def test_whole_numbers_are_exact(image):
    values, meta, _ = decoded(frame_page(image))
    assert np.array_equal(values, image)
    assert meta["step"] == 1


def test_other_numbers_are_rounded_far_below_the_noise_and_gaps_are_said():
    image = np.random.default_rng(4).normal(0.3, 0.02, (60, 50))
    image[7, 9] = np.nan
    values, meta, parts = decoded(frame_page(image))
    known = np.isfinite(image)
    assert np.abs(values - image)[known].max() < 0.02 / 64
    assert [(flag["name"], flag["count"]) for flag in meta["flags"]] == [("no value", 1)]
    bits = np.frombuffer(zlib.decompress(base64.b64decode(parts.script["flags"])), np.uint8).reshape(image.shape)
    assert np.argwhere(bits).tolist() == [[7, 9]]


def test_nothing_comes_from_elsewhere():
    page = frame_page(np.eye(9), [marks()], facts={"exposure": "1 s"})
    for tag, name, value in Parts(page).attributes:
        if name in ("src", "href", "srcset", "action", "data"):
            assert (value or "").startswith("data:"), (tag, name)
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|@import|url\(", page)


def test_text_of_others_stays_text():
    bad = '</script><script>alert("@title@")</script>'
    page = frame_page(
        np.eye(4), [marks(name=bad, label=[bad] * 3, columns={bad: [bad] * 3})], title=bad, facts={bad: bad}
    )
    parts = Parts(page)
    assert set(parts.script) - {"flags"} == {"meta", "pixels", "program"}
    assert json.loads(parts.script["meta"])["layers"][0]["label"] == [bad] * 3
    assert "alert" not in parts.script["program"]
    assert {value for tag, name, value in parts.attributes if tag == "div" and name == "aria-label"} == {
        f"{bad}: image of 4 by 4 pixels, 3 {bad}"
    }


def test_marks_without_a_place_are_left_out_and_numbers_that_are_none_are_null():
    layer = marks(x_px=np.array([1.0, np.nan, 3.0]), columns={"flux [e-]": np.array([1.5, 2.0, np.inf])})
    (layer_data,) = decoded(frame_page(np.eye(4), [layer]))[1]["layers"]
    assert (layer_data["x"], layer_data["y"]) == ([1.0, 3.0], [0.0, 4.0])
    assert layer_data["columns"] == [{"name": "flux", "unit": "e-", "values": [1.5, None]}]


def test_errors_are_those_to_the_nearest_reference():
    reference = marks(4, x_px=np.array([10.0, 20.0, 30.0, np.nan]), y_px=np.array([5.0, 5.0, 5.0, 5.0]))
    measured = [
        marks(2, x_px=np.array([10.25, 21.0]), y_px=np.array([4.5, 5.0])),
        marks(1, x_px=np.array([33.0]), y_px=np.array([5.0])),
    ]
    arrows = differences(measured, reference, within_px=2.0)
    assert arrows.x_px.tolist() == [10.0, 20.0]
    assert np.column_stack([arrows.dx_px, arrows.dy_px]).tolist() == [[0.25, -0.5], [1.0, 0.0]]
    assert not len(differences([], reference).x_px)
    assert not len(differences(measured, marks(0)).x_px)


@pytest.mark.slow
def test_eight_million_pixels_of_pure_noise_stay_below_30_mb(tmp_path):
    image = np.random.default_rng(5).integers(0, 65536, (2048, 4096)).astype(np.uint16)
    page = save_frame_page(tmp_path / "page.html", image)
    assert page.stat().st_size < 30e6
