"""Makes docs/pictures/chromatic.png: the lens, and what the chromatic test measures through it.

Run from the repository root: ``python docs/make_chromatic_picture.py`` (it runs the default experiment).
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.chromatic.experiment import field_map, run
from experiments.chromatic.settings import ChromaticConfig, rendered
from experiments.harness.plotting import figure_png, house_style
from experiments.harness.progress import Progress
from optics.figures import draw_lens
from render.engine import Engine

WIDTH_PX = 1500
TARGET = Path(__file__).with_name("pictures") / "chromatic.png"


def main() -> None:
    """Run, draw, stack."""
    Engine.start("auto")
    config = ChromaticConfig()
    outcome = rendered.outcome(config, run(config, progress=Progress()))
    drawing = draw_lens(outcome.result["bench"].instrument.camera.lens)
    with house_style():
        maps = field_map(outcome, [config.pair])
        images = [Image.open(io.BytesIO(figure_png(figure))).convert("RGBA") for figure in (drawing, maps)]
    scaled = [image.resize((WIDTH_PX, round(image.height * WIDTH_PX / image.width))) for image in images]
    sheet = Image.new("RGBA", (WIDTH_PX, sum(image.height for image in scaled)), "white")
    top = 0
    for image in scaled:
        sheet.alpha_composite(image, (0, top))
        top += image.height
    sheet.convert("RGB").quantize(128).save(TARGET, optimize=True)
    print(TARGET.name, sheet.size, TARGET.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
