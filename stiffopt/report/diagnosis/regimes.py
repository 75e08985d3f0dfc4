"""Residuals of one channel, and their figures by regime and against a finding's model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.names import Channel
from stiffopt.report.common import svg
from stiffopt.report.common.text import scale
from stiffopt.units import joint_unit

_CELL_COUNT = 14
DIRECTION_STYLES = ((1, svg.VERMILLION, "positive direction"), (-1, svg.BLUE, "negative direction"))


@svg.figure_style()
def regime_figure(diagnosis: Diagnosis, rows: ChannelResiduals, finding: Finding | None) -> Figure:
    """Plot the mean residual over speed, load, position, acceleration, session time, rotor angle.

    With a finding: residual without this finding but with all others, and the finding's model as a
    line. Without one: the remaining residual.
    """
    added = (
        np.zeros(len(rows.after))
        if finding is None
        else finding_contribution(diagnosis, finding, rows)
    )
    residual = rows.after + added
    factor, unit = scale(float(np.quantile(np.abs(residual), 0.95)), rows.unit)
    sides = motion_direction(diagnosis, rows)
    electrical = finding is not None and "pole_pairs" in finding.effect.needs
    shown = list(regimes(diagnosis, rows, electrical))
    noise = factor * float(np.median(rows.noise))
    figure, grid = svg.subplots(5.0, 2, 3, sharey=True)
    for axes, regime in zip(grid.flat, shown, strict=True):
        axes.axhspan(-noise, noise, color=svg.PALE, alpha=0.55, zorder=0, linewidth=0)
        for side, colour, _ in DIRECTION_STYLES:
            own = sides == side
            if own.sum() > 1:
                draw_direction(
                    axes, regime, own, factor * residual, factor * added, rows.run, colour
                )
        axes.set_xlabel(regime.label)
    for line in grid:
        line[0].set_ylabel(f"mean residual [{unit}]")
    handles = [
        grid[0, 0].plot([], [], "o", color=colour, ms=4)[0] for _, colour, _ in DIRECTION_STYLES
    ]
    labels = [words for _, _, words in DIRECTION_STYLES]
    if finding is not None:
        handles.append(grid[0, 0].plot([], [], color=svg.GREY, linewidth=1.4)[0])
        labels.append("model of the finding")
    handles.append(grid[0, 0].fill_between([], [], color=svg.PALE))
    labels.append("noise of one sample, ±1 standard deviation")
    figure.legend(handles, labels, loc="upper left", ncols=4, bbox_to_anchor=(0.05, 0.03))
    figure.subplots_adjust(left=0.065, right=0.99, wspace=0.08, hspace=0.3)
    return figure


def draw_direction(
    axes: Axes,
    regime: Regime,
    own: np.ndarray,
    residual: np.ndarray,
    added: np.ndarray,
    run: np.ndarray,
    colour: str,
) -> None:
    """Draw mean residual and model of one direction of motion (mask) over a regime."""
    x = regime.values[own]
    groups = [run[own] == r for r in np.unique(run)] if regime.apart else [np.ones(len(x), bool)]
    for group in groups:
        if group.sum() < 2:
            continue
        low, high = np.quantile(x[group], (0.002, 0.998))
        edges = np.linspace(low, high, 6 if regime.apart else 28)
        centre, mean, sd = binned_means(x[group], residual[own][group], edges)
        if not len(centre):
            continue
        axes.errorbar(centre, mean, yerr=2.0 * sd, fmt="o", color=colour, ms=3.2, elinewidth=0.9)
        if added.any():
            centre, model, _ = binned_means(x[group], added[own][group], edges)
            axes.plot(centre, model, color=colour, linewidth=1.4, alpha=0.75)


@svg.figure_style()
def map_figure(diagnosis: Diagnosis, rows: ChannelResiduals, finding: Finding | None) -> Figure:
    """Plot the mean residual over speed and load, and speed and position, without and with it."""
    by_name = {regime.name: regime for regime in regimes(diagnosis, rows)}
    stages = (
        [("without it", finding_contribution(diagnosis, finding, rows) + rows.after)]
        if finding
        else []
    )
    stages.append(("with it" if finding else "residual", rows.after))
    ratios = [values / rows.noise for _, values in stages]
    panels = [(other, number) for other in ("load", "position") for number in range(len(stages))]
    maps = [
        _cell_means(by_name["speed"].values, by_name[other].values, ratios[number])
        for other, number in panels
    ]
    filled = np.concatenate([np.abs(m[2][np.isfinite(m[2])]) for m in maps])
    top = max(2.0, float(np.quantile(filled, 0.98))) if filled.size else 2.0
    figure, grid = svg.panels(len(panels), len(panels), (svg.WIDTH, 2.9))
    for axes, (other, number), (x, y, values) in zip(grid, panels, maps, strict=True):
        image = axes.pcolormesh(x, y, values.T, cmap="RdBu_r", vmin=-top, vmax=top)
        image.set_edgecolor("face")
        axes.set_title(f"{other} and speed, {stages[number][0]}", size=8.5)
        axes.set_xlabel(by_name["speed"].label)
        if number == 0:
            axes.set_ylabel(by_name[other].label)
        axes.grid(visible=False)
    figure.subplots_adjust(left=0.065, right=0.91, wspace=0.3)
    bar = figure.colorbar(image, cax=figure.add_axes((0.93, 0.15, 0.012, 0.7)))
    bar.set_label("mean residual over noise")
    bar.outline.set_visible(False)
    return figure


def _cell_means(
    x: np.ndarray, y: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return edges and means of z over a grid in x and y; nan in cells with too few samples."""
    ends = [np.quantile(v, (0.002, 0.998)) for v in (x, y)]
    edges = [np.linspace(low, high, _CELL_COUNT + 1) for low, high in ends]
    if not all(np.all(np.diff(e) > 0.0) for e in edges):
        edges = [np.linspace(v.min() - 1e-9, v.max() + 1e-9, _CELL_COUNT + 1) for v in (x, y)]
    count, total = (np.histogram2d(x, y, bins=edges, weights=weights)[0] for weights in (None, z))
    means = np.where(count >= 4, total / np.maximum(count, 1.0), np.nan)
    return edges[0], edges[1], means


@svg.figure_style()
def regressor_figure(diagnosis: Diagnosis, rows: ChannelResiduals, finding: Finding) -> Figure:
    """Plot the residual without a finding, but with all others, against the finding's model."""
    added = finding_contribution(diagnosis, finding, rows)
    residual = rows.after + added
    factor, unit = scale(float(np.quantile(np.abs(residual), 0.95)), rows.unit)
    x, y = factor * added, factor * residual
    # Points of a scatter plot.
    step = max(1, len(x) // 1500)
    figure, (left, right) = svg.subplots(3.4, 1, 2, width_ratios=(1.5, 1.0))
    left.plot(x[::step], y[::step], ".", color=svg.SKY, ms=3, alpha=0.5, label="samples, filtered")
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, 25)))
    if len(edges) > 2:
        centre, mean, sd = binned_means(x, y, edges)
        left.errorbar(
            centre,
            mean,
            yerr=2.0 * sd,
            fmt="o",
            color=svg.INK,
            ms=4,
            elinewidth=1.0,
            label="means, ±2 standard deviations",
        )
    ends = np.array([x.min(), x.max()])
    left.plot(ends, ends, color=svg.VERMILLION, linewidth=1.6, label="model: measured = predicted")
    left.set_xlabel(f"contribution of the finding by its model [{unit}]")
    left.set_ylabel(f"residual without it [{unit}]")
    left.legend(loc="upper left")
    _draw_histogram(right, rows, residual)
    figure.subplots_adjust(left=0.065, right=0.99, wspace=0.2)
    return figure


def _draw_histogram(axes: Axes, rows: ChannelResiduals, residual: np.ndarray) -> None:
    """Draw histograms of residual over noise, without and with the finding, and the normal."""
    without, with_it = residual / rows.noise, rows.after / rows.noise
    reach = float(np.clip(np.quantile(np.abs(without), 0.99), 4.0, 40.0))
    bins = np.linspace(-reach, reach, 61).tolist()
    for values, colour, label in (
        (without, svg.VERMILLION, "without the finding"),
        (with_it, svg.BLUE, "with it"),
    ):
        shown = np.clip(values, -reach, reach)
        axes.hist(shown, bins, density=True, histtype="step", color=colour, lw=1.4, label=label)
    place = np.linspace(-4.0, 4.0, 81)
    density = np.exp(-0.5 * place**2) / np.sqrt(2.0 * np.pi)
    axes.plot(
        place, density, color=svg.GREY, linewidth=1.0, linestyle=(0, (4, 2)), label="noise alone"
    )
    axes.set_xlabel("residual over noise")
    axes.set_ylabel("share of samples per unit")
    axes.legend(loc="upper left")


@svg.figure_style()
def spectrum_figure(rows: ChannelResiduals, time: np.ndarray, period: float) -> Figure:
    """Plot the share of the squared residual that a sinusoid of each frequency explains."""
    runs = [rows.run == r for r in np.unique(rows.run)]
    span = min(float(np.ptp(time[own])) for own in runs)
    frequencies = np.arange(1.5 / span, max(4.0 / period, 20.0 / span), 0.2 / span)
    share = np.zeros(len(frequencies))
    total = float(np.sum(rows.after**2))
    for own in runs:
        y, t = rows.after[own], time[own]
        for i, f in enumerate(frequencies):
            waves = np.column_stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)])
            share[i] += float((waves.T @ y) @ np.linalg.solve(waves.T @ waves, waves.T @ y))
    figure, axes = svg.subplots(2.6)
    axes.plot(frequencies, 100.0 * share / total, color=svg.BLUE)
    axes.axvline(1.0 / period, color=svg.PURPLE, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("share of the squared residual [%]")
    axes.set_ylim(0.0)
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.2)
    return figure


@dataclass(frozen=True, eq=False)
class ChannelResiduals:
    """Filtered residuals of one channel in the training runs."""

    name: str  # name such as "torque_3"
    joint: int  # from 0
    unit: str  # unit of the residuals, SI
    # (m,) residual of the nominal model, and with findings and calibrated nominal values.
    before: np.ndarray
    after: np.ndarray
    noise: np.ndarray  # (m,) standard deviation of each sample
    run: np.ndarray  # (m,) index of the run
    chosen: np.ndarray  # (m,) indices of the rows in the search


@dataclass(frozen=True, eq=False)
class Regime:
    """A signal on which a residual may depend."""

    # The label has the unit.
    name: str
    label: str
    values: np.ndarray  # (m,) in the label's unit
    apart: bool = False  # True where each run is a separate group of values, not to be connected


def channel_residuals(diagnosis: Diagnosis, name: str) -> ChannelResiduals:
    """Return the residuals of a channel in its own unit, before and after."""
    search = diagnosis.search
    rows, comparison = search.comparison.rows, search.comparison
    number = Channel.read(name).number(diagnosis.recordings.n)
    joint = number % diagnosis.recordings.n
    chosen = np.flatnonzero(rows.channel == number)
    noises = comparison.noise
    sd = float((noises.torque if number < rows.n else noises.deflection)[joint])
    gain = rows.sample_signal(lambda run: np.full(len(run.time), run.low_pass.noise_gain))[chosen]
    noise = sd * gain
    slides = diagnosis.training.constants.joints[joint].prismatic
    return ChannelResiduals(
        name=name,
        joint=joint,
        unit=joint_unit("N m" if number < rows.n else "rad", slides),
        before=search.target[chosen] * noise,
        after=search.fit.residual[chosen] * noise,
        noise=noise,
        run=rows.sample_signal(lambda run: np.full(len(run.time), run.index))[chosen],
        chosen=chosen,
    )


def finding_contribution(
    diagnosis: Diagnosis, finding: Finding, rows: ChannelResiduals
) -> np.ndarray:
    """Return the contribution of a finding to a channel (m,), fitted beside all others."""
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
    """Yield speed, load, position, acceleration, session time and rotor angle of the joint.

    `electrical`: use the electrical angle of the motor, where its pole pairs are known.
    """
    sampled = diagnosis.search.comparison.rows.sample_signal
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
    """Return the direction of the joint's motion at every row, -1 or 1."""
    speed = diagnosis.search.comparison.rows.sample_signal(
        lambda run: run.signals.motor_velocity[:, rows.joint]
    )[rows.chosen]
    return np.where(speed < 0.0, -1, 1)


def binned_means(
    x: np.ndarray, y: np.ndarray, edges: np.ndarray, least: int = 6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean x, mean y and its standard error of each bin with at least `least` samples."""
    number = np.digitize(x, edges) - 1
    found = []
    for b in range(len(edges) - 1):
        own = number == b
        count = int(own.sum())
        if count >= least:
            found.append((x[own].mean(), y[own].mean(), y[own].std() / np.sqrt(count)))
    table = np.array(found).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]
