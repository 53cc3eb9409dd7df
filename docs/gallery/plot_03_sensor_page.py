"""
What a star sensor will do
==========================

`run_experiment` does from Python what ``python -m experiments.camera --sensor sensor.toml`` does: the prediction takes
seconds and needs no frames. Here for the sensor file of the manual.
"""

from experiments import run_experiment

page = run_experiment("camera", {"predict_only": True}, sensor="../examples/triplet_50mm/sensor.toml")
for name in ("optics", "accuracy", "sky"):
    page.table(name).pprint(max_width=-1)
accuracy = page.draw("magnitude_accuracy")
