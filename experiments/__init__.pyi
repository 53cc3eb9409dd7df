# Public names and where they live; experiments/__init__.py loads them on first use.
from .harness.run import ExperimentRun as ExperimentRun
from .harness.run import run_experiment as run_experiment
from .laboratory.sensor_prediction import predict_sensor as predict_sensor
