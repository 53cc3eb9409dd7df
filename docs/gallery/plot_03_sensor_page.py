"""
What a star sensor will do
==========================

`run_experiment` is ``python -m experiments.camera --sensor sensor.toml`` from Python. The prediction takes seconds and
needs no frames. The sensor file is the example of the user guide.
"""

from experiments import run_experiment

page = run_experiment("camera", {"predict_only": True}, sensor="../examples/triplet_50mm/sensor.toml")
for name in ("optics", "accuracy", "sky"):
    page.table(name).pprint(max_width=-1)
accuracy = page.draw("magnitude_accuracy")
