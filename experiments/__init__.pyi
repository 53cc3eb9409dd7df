# Public names and where they live; experiments/__init__.py loads them on first use.
from .harness.library import ExperimentRun as ExperimentRun
from .harness.library import run_experiment as run_experiment
