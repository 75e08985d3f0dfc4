"""Residuals of one channel of the training runs beside what the joint was doing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.diagnosis.words import channel_number
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis, Finding


@dataclass(frozen=True, eq=False)
class ChannelResiduals:
    """Filtered samples of one channel that a search has compared.

    Parameters
    ----------
    name : str
        Such as "torque_3".
    joint : int
        From 0.
    unit : str
        Of the residuals, SI.
    before, after : array (m,)
        Residual of the nominal model, and with all that was found and calibrated.
    noise : array (m,)
        One standard deviation of each sample.
    run : array (m,) of int
        Number of the run.
    chosen : array (m,) of int
        Place among the rows of the search.
    """

    name: str
    joint: int
    unit: str
    before: np.ndarray
    after: np.ndarray
    noise: np.ndarray
    run: np.ndarray
    chosen: np.ndarray


@dataclass(frozen=True, eq=False)
class Regime:
    """What a residual may depend on.

    Parameters
    ----------
    name, label : str
        The label has the unit.
    values : array (m,)
        In the label's unit.
    apart : bool
        Values come in groups, one a run, between which no line may be drawn.
    """

    name: str
    label: str
    values: np.ndarray
    apart: bool = False


def channel_residuals(diagnosis: Diagnosis, name: str) -> ChannelResiduals:
    """Residuals of a channel before and after, in its own unit."""
    search = diagnosis.search
    rows, comparison = search.comparison.rows, search.comparison
    number = channel_number(diagnosis, name)
    joint = number % diagnosis.recordings.n
    chosen = np.flatnonzero(rows.channel == number)
    noises = comparison.noise
    sd = float((noises.torque if number < rows.n else noises.deflection)[joint])
    gain = rows.sampled(lambda run: np.full(len(run.time), run.low_pass.noise_gain))[chosen]
    noise = sd * gain
    slides = diagnosis.training.constants.joints[joint].prismatic
    return ChannelResiduals(
        name=name,
        joint=joint,
        unit=joint_unit("N m" if number < rows.n else "rad", slides),
        before=search.target[chosen] * noise,
        after=search.fit.residual[chosen] * noise,
        noise=noise,
        run=rows.sampled(lambda run: np.full(len(run.time), run.index))[chosen],
        chosen=chosen,
    )


def finding_contribution(
    diagnosis: Diagnosis, finding: Finding, rows: ChannelResiduals
) -> np.ndarray:
    """What a finding adds to a channel, as fitted beside all others (m,)."""
    search = diagnosis.search
    begin = 0
    for located in search.fit.effects:
        count = len(located.effect.amplitudes)
        if located.same_place(finding.located):
            own = search.fit.amplitudes()[begin : begin + count]
            columns = search.comparison.effect_columns(located)[rows.chosen]
            number = search.comparison.rows.channel[rows.chosen]
            return np.asarray(columns @ own * search.comparison.inflation[number] * rows.noise)
        begin += count
    return np.zeros(len(rows.chosen))


def regimes(
    diagnosis: Diagnosis, rows: ChannelResiduals, electrical: bool = False
) -> Iterator[Regime]:
    """Speed, load, position, acceleration, session time and rotor angle of a channel's joint.

    Parameters
    ----------
    diagnosis : Diagnosis
    rows : ChannelResiduals
    electrical : bool
        Fold the rotor angle by electrical turns of the motor, where its pole pairs are known.
    """
    sampled = diagnosis.search.comparison.rows.sampled
    constants = diagnosis.training.constants.joints[rows.joint]
    length = joint_unit("rad", constants.prismatic)

    def own(name: str) -> np.ndarray:
        whole = sampled(lambda run: getattr(run.signals, name)[:, rows.joint])
        return np.asarray(whole[rows.chosen])

    yield Regime("speed", f"joint speed [{length}/s]", own("motor_velocity"))
    force = joint_unit("N m", constants.prismatic)
    yield Regime("load", f"load of the joint, nominal [{force}]", own("spring_torque"))
    position = own("motor_position")
    yield Regime("position", f"joint position [{length}]", position)
    yield Regime("acceleration", f"joint acceleration [{length}/s²]", own("motor_acceleration"))
    session = sampled(lambda run: run.signals.session_time)[rows.chosen]
    several = len(set(rows.run.tolist())) > 1
    yield Regime("session time", "time since switching on [min]", session / 60.0, several)
    if constants.ratio > 1.0 and not constants.prismatic:
        turns = constants.ratio * position / (2.0 * np.pi)
        if electrical and constants.pole_pairs:
            label = "electrical angle of the motor [turns]"
            yield Regime("rotor", label, np.mod(turns * constants.pole_pairs, 1.0))
        else:
            yield Regime("rotor", "rotor angle [turns]", np.mod(turns, 1.0))
    else:
        time = sampled(lambda run: run.time)[rows.chosen]
        yield Regime("time", "time in the run [s]", time)


def motion_direction(diagnosis: Diagnosis, rows: ChannelResiduals) -> np.ndarray:
    """Direction of the joint's motion at every row, -1 or 1."""
    speed = diagnosis.search.comparison.rows.sampled(
        lambda run: run.signals.motor_velocity[:, rows.joint]
    )[rows.chosen]
    return np.where(speed < 0.0, -1, 1)


def binned_means(
    x: np.ndarray, y: np.ndarray, edges: np.ndarray, least: int = 6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of y by bins of x.

    Parameters
    ----------
    x, y : array (m,)
    edges : array (b + 1,)
    least : int
        Samples below which a bin is left out.

    Returns
    -------
    (array, array, array)
        Mean x, mean y and standard deviation of the mean of every bin that is kept.
    """
    number = np.digitize(x, edges) - 1
    found = []
    for b in range(len(edges) - 1):
        own = number == b
        count = int(own.sum())
        if count >= least:
            found.append((x[own].mean(), y[own].mean(), y[own].std() / np.sqrt(count)))
    table = np.array(found).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]
