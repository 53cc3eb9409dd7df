"""What is written when all frames are there: exports, index, data card, contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.dataset.frames.splits import SPLITS
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.dataset.evaluation.evaluate import Example
    from experiments.dataset.frames.scene import Scene
    from experiments.dataset.result import Result

__all__ = ["EXPORTS", "write_closing_files", "write_exports"]

EXPORTS = ("coco", "webdataset")
"""Their names are those of their folders."""


def write_exports(scene: Scene, folder: Path, records: Sequence[FrameRecord], progress: Progress) -> dict[str, str]:
    """The exports asked for; name -> what was written, in words."""
    from experiments.dataset.exports.about import about
    from experiments.dataset.exports.calibration import write_calibration
    from experiments.dataset.exports.coco import export_coco
    from experiments.dataset.exports.webdataset_shards import export_shards
    from experiments.dataset.frames.maker import FrameMaker
    from experiments.dataset.truth.labels import LabelMaker

    config = scene.config
    written: dict[str, str] = {}
    there = {name for name in EXPORTS if (folder / name).is_dir()}  # what was exported once is kept up to date
    for name in sorted({*config.exports, *there}):
        with progress.stage(f"export {name}", total=len(records)) as stage:
            if name == "coco":
                written[name] = export_coco(
                    folder,
                    records,
                    diffusion_px=scene.instrument.detector.diffusion_sigma_px,
                    bits=config.png_bits,
                    labels=LabelMaker(scene, FrameMaker(scene).hits).labels,
                    about=about(config, scene.catalogue.catalog),
                    done=stage.advance,
                )
            else:
                written[name] = export_shards(folder, records, done=stage.advance)
    if config.calibration_frames > 1:
        with progress.stage("calibration", total=3) as stage:
            written["calibration"] = write_calibration(scene, folder, config.calibration_frames, stage.advance)
    return written


def write_closing_files(result: Result, folder: Path) -> None:
    """Index, data card, Croissant and contact sheet into a folder."""
    from experiments.dataset.exports.contact_sheet import contact_sheet
    from experiments.dataset.exports.croissant import croissant
    from experiments.dataset.exports.data_card import data_card
    from experiments.dataset.production.folder import file_digest
    from experiments.dataset.truth.files import index_bytes

    truth = {one.truth: file_digest(result.folder / one.truth) for one in result.records}
    if result.config.files.truth == "ecsv":
        (folder / "index.ecsv").write_bytes(index_bytes(result.records, "ecsv", truth))
    (folder / "index.parquet").write_bytes(index_bytes(result.records, "parquet", truth))
    for split in SPLITS:
        some = [one for one in result.records if one.split == split]
        if some:
            (folder / f"index_{split}.parquet").write_bytes(index_bytes(some, "parquet", truth))
    (folder / "croissant.json").write_text(croissant(result, folder), encoding="utf-8")
    (folder / "README.md").write_text(data_card(result), encoding="utf-8")
    if result.evaluation is not None and result.evaluation.example is not None:
        _write_frame_page(result, result.evaluation.example, folder)
    (folder / "contact_sheet.png").write_bytes(contact_sheet(result.folder, result.records))


def _write_frame_page(result: Result, example: Example, folder: Path) -> None:
    """``frame.html``: the frame that the report shows, to zoom into."""
    from calib.figures import star_marks
    from experiments.laboratory.truth_marks import truth_marks
    from optics.fits import image_header
    from optics.page import differences, save_frame_page
    from render.fits.files import read_frame
    from render.fits.wcs import sky_grid

    record = next(one for one in result.records if one.frame == example.frame)
    frame, true = read_frame(result.folder / record.file), truth_marks(example.truth)
    measured = star_marks(example.measured.stars)
    save_frame_page(
        folder / "frame.html",
        frame.dn,
        [true, *measured, differences([one for one in measured if one.shape != "cross"], true)],
        title=f"Frame {record.frame}",
        facts={"exposure": f"{record.exposure_s:g} s", "split": record.split, "filter": frame.band},
        flags={"saturated": frame.saturated, "defective": frame.defect},
        sky=sky_grid(image_header(result.folder / record.file), frame.dn.shape),
    )
