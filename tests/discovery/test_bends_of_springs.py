"""Links are followed past a bend of their springs about which the motion goes to and fro."""

import numpy as np
from simulated_sets import simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import train
from stiffopt.recording.recording_set import load_recordings


def test_to_and_fro_by_less_than_is_let_be_is_a_motion(tmp_path):
    """Joint 6 at a bend, by 0.2 urad: no motion was found, and links counted as in balance."""
    spec = CaseSpec(
        robot="arm7",
        seed=107,
        tolerance=0.0,
        train=1,
        test=1,
        extrapolate=0,
        seconds=5.0,
        rate=250.0,
        substeps=8,
        smoothing=0.2,
        payload=5.891215516401546,
    )
    case = simulated(spec)
    training = train(load_recordings(write_case(case, tmp_path / "set")), Settings())
    (run,) = training.runs
    assert run.swing is not None
    true = case.trace.link[0, :: spec.substeps][: len(run.time)]
    off = (run.signals.link_position - true) / training.noise.channels.deflection
    assert np.sqrt(np.mean(off**2)) < 1.5
