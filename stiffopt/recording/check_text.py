"""The report on a recording set in plain lines, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from stiffopt.recording.check import ChannelCheck, RecordingReport, RunCheck


def report_lines(report: RecordingReport) -> Iterator[str]:
    """Lines of text: runs, channels, faults, what is missing, what can be identified."""
    yield f"{report.title}: {len(report.joints)} joints, {len(report.runs)} runs"
    for run in report.runs:
        yield ""
        yield from _run(run)
    yield ""
    yield "Balances"
    for joint, (name, found) in enumerate(zip(report.joints, report.balances, strict=True), 1):
        yield f"  joint {joint} ({name}): {', '.join(found) or 'none'}"
    yield ""
    yield "Can be identified"
    yield from _effects(report)
    for heading, sentences in (
        ("Missing", report.missing),
        ("Assumed", report.assumptions),
    ):
        if sentences:
            yield ""
            yield heading
            yield from (f"  {sentence}" for sentence in sentences)


def _run(run: RunCheck) -> Iterator[str]:
    gap = f", longest wait {1e3 * run.longest_gap:.3g} ms" if run.jitter > 0.0 else ""
    yield (
        f"{run.file} ({run.role}): {run.samples} samples, {run.duration:.4g} s, "
        f"{run.rate:.4g} Hz, jitter {1e3 * run.jitter:.2g} ms{gap}"
    )
    if not run.usable:
        yield "  cannot be used"
    yield from (f"  {_channel(channel)}" for channel in run.channels)
    yield from (f"  ! {fault}" for fault in run.faults)


def _channel(channel: ChannelCheck) -> str:
    text = f"{channel.column} ({channel.signal} of joint {channel.joint}): "
    if not channel.there:
        return f"{text}left out"
    text += f"{channel.lowest:.4g} to {channel.highest:.4g} {channel.unit}"
    if channel.used is not None:
        share = f"{100.0 * channel.used:.0f}" if channel.used >= 0.01 else "under 1"
        text += f" ({share} % of its limits)"
    text += f", noise {channel.noise:.2g}"
    if channel.stated_noise is not None:
        text += f" (stated {channel.stated_noise:.2g})"
    if channel.step is not None:
        text += f", counts of {channel.step:.3g}"
    return text


def _effects(report: RecordingReport) -> Iterator[str]:
    """Each effect with the joints it can be told on, and the reasons for the others."""
    for effect in dict.fromkeys(check.effect for check in report.effects):
        checks = [check for check in report.effects if check.effect == effect]
        if checks[0].joint is None:
            yield f"  {effect}: " + (
                "yes" if checks[0].possible else f"no, {_why(checks[0].lacks)}"
            )
            continue
        good = [str(check.joint) for check in checks if check.possible]
        reasons: dict[str, list[str]] = {}
        for check in checks:
            if not check.possible:
                reasons.setdefault(_why(check.lacks), []).append(str(check.joint))
        text = _joints(good) if good else "no joint"
        for reason, joints in reasons.items():
            text += f"; not {', '.join(joints)} ({reason})"
        yield f"  {effect}: {text}"


def _joints(numbers: list[str]) -> str:
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"


def _why(lacks: tuple[str, ...]) -> str:
    return ", ".join(lacks)
