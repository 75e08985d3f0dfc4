"""report.html of a static set: stiffness of the joints, how sure, and torque dependence."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from stiffopt.files import atomic_write
from stiffopt.identification.result import JointStiffness, StaticStiffness
from stiffopt.report.common.quantities import engineering, significant
from stiffopt.report.common.rendering import PageFigure, page_figure, write_page
from stiffopt.report.common.svg import to_png, to_svg
from stiffopt.report.identification.figures import (
    models_figure,
    poses_figure,
    prediction_figure,
    secant_figure,
    stiffness_figure,
)
from stiffopt.report.solve.tables import DASH, Table

PAGE_FILE = "report.html"


def write_static_report(result: StaticStiffness, folder: Path) -> Path:
    """Write report.html and its figures as SVG and PNG into `folder`; return the page."""
    errors = result.errors
    tiles = [
        ("poses", str(len(result.predicted)), f"{3 * len(result.predicted)} displacements"),
        ("error, poses left out", engineering(errors.left_out, "m", 3), "rms of one component"),
        ("displacement", engineering(errors.displacement, "m", 3), "rms of one component"),
    ]
    if errors.nominal is not None:
        tiles.append(("error, nominal", engineering(errors.nominal, "m", 3), "all poses"))
    tiles.append(("torque dependence", result.torque_dependence.verdict, ""))
    context = {
        "title": f"{result.source.title}: joint stiffness from static deflections",
        "headline": headline(result),
        "subline": error_sentence(result),
        "supported": result.torque_dependence.verdict == "supported",
        "dependence": result.torque_dependence.sentence,
        "tiles": tiles,
        "figures": _figures(result, folder),
        "stiffness": stiffness_table(result),
        "spread": _spread_table(result),
        "reasons": [f"J{joint.joint}: {joint.reason}" for joint in result.joints if joint.reason],
        "errors": _errors_table(result),
        "models": _models_table(result),
        "outliers": _outliers_table(result),
        "assumptions": result.assumptions,
        "source": _source(result),
    }
    return write_page("static.html.j2", folder / PAGE_FILE, context)


def headline(result: StaticStiffness) -> str:
    """How many joints were identified, in words."""
    count = sum(joint.status == "identified" for joint in result.joints)
    return f"Stiffness of {count} of {len(result.joints)} joints identified"


def error_sentence(result: StaticStiffness) -> str:
    """Error on poses left out, beside the nominal stiffness where there is one."""
    errors = result.errors
    text = (
        f"Poses left out are predicted to {engineering(errors.left_out, 'm', 3)} of "
        f"{engineering(errors.displacement, 'm', 3)} (rms of one component)"
    )
    if errors.nominal is not None:
        text += f"; with the nominal stiffness to {engineering(errors.nominal, 'm', 3)}"
    return f"{text}."


def stiffness_table(result: StaticStiffness) -> Table:
    """Stiffness, deviation, interval and nominal value of every joint."""
    rows = [
        (
            f"J{joint.joint}",
            joint.name,
            _status(joint),
            _number(joint.stiffness),
            _number(joint.sd, 2),
            _interval(joint.lower, joint.upper),
            _number(joint.nominal),
            DASH if joint.z_nominal is None else f"{joint.z_nominal:+.1f}",
            joint.unit,
        )
        for joint in result.joints
    ]
    head = (
        "",
        "joint",
        "",
        "stiffness",
        "standard deviation",
        "95 % interval",
        "nominal",
        "softer than nominal by (standard deviations)",
        "unit",
    )
    bad = frozenset(k for k, j in enumerate(result.joints) if j.status != "identified")
    return Table(head, tuple(rows), bad)


def _status(joint: JointStiffness) -> str:
    names = {
        "identified": "identified",
        "lower_bound": "lower bound only",
        "not_loaded": "not identifiable",
        "confounded": "not identifiable",
    }
    return names[joint.status]


def _number(value: float | None, digits: int = 3) -> str:
    """Number such as 2.67e5: stiffness of one arm spans decades."""
    if value is None:
        return DASH
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def _interval(lower: float | None, upper: float | None) -> str:
    if lower is None:
        return DASH
    return f"above {_number(lower)}" if upper is None else f"{_number(lower)} to {_number(upper)}"


def _spread_table(result: StaticStiffness) -> Table:
    rows = []
    for joint in result.joints:
        if joint.compliance is None:
            continue
        deviations = (joint.compliance_sd_alike, joint.compliance_sd, joint.compliance_sd_bootstrap)
        low, middle, high = joint.torque
        rows.append(
            (
                f"J{joint.joint}",
                _number(joint.compliance),
                *(_number(each, 2) for each in deviations),
                _interval(joint.bootstrap_lower, joint.bootstrap_upper),
                _number(joint.least_squares),
                f"{significant(low, 3)} / {significant(middle, 3)} / {significant(high, 3)}",
            )
        )
    head = (
        "",
        "compliance",
        "sd, errors alike",
        "sd, poses left out",
        "sd, poses drawn anew",
        "stiffness, middle 95 % of poses drawn anew",
        "stiffness, plain least squares",
        "torque at 5 / 50 / 95 % of the poses",
    )
    return Table(head, tuple(rows))


def _errors_table(result: StaticStiffness) -> Table:
    errors = result.errors
    rows = [
        ("measured displacement", engineering(errors.displacement, "m"), DASH),
        ("identified", engineering(errors.fit, "m"), engineering(errors.left_out, "m")),
        (
            "plain least squares",
            engineering(errors.least_squares, "m"),
            engineering(errors.least_squares_left_out, "m"),
        ),
    ]
    if errors.nominal is not None:
        rows.append(("nominal stiffness", engineering(errors.nominal, "m"), DASH))
    return Table(("rms of one component", "all poses", "poses left out one at a time"), tuple(rows))


def _models_table(result: StaticStiffness) -> Table | None:
    models = result.torque_dependence.models
    rows = [
        (
            model.name,
            model.formula,
            model.shape or DASH,
            str(model.parameters),
            engineering(model.fit, "m"),
            engineering(model.left_out, "m"),
            DASH if model is models[0] else f"{-100 * model.gain:+.1f} %",
            f"{model.chance:.2g}" if model.candidate else DASH,
        )
        for model in models
    ]
    head = (
        "model",
        "wind-up at the torque s",
        "form chosen",
        "parameters",
        "error, all poses",
        "error, poses left out",
        "change",
        "probability of chance",
    )
    return Table(head, tuple(rows)) if rows else None


def _outliers_table(result: StaticStiffness) -> Table | None:
    measured = result.rows.displacement
    rows = []
    for pose in result.outliers:
        error = float(((measured[pose - 1] - result.predicted[pose - 1]) ** 2).sum() ** 0.5)
        size = float((measured[pose - 1] ** 2).sum() ** 0.5)
        rows.append(
            (
                str(pose),
                engineering(size, "m", 3),
                engineering(error, "m", 3),
                f"{error / result.scale:.1f}" if result.scale else DASH,
                f"{100 * result.weight[pose - 1]:.0f} %",
            )
        )
    head = ("pose", "displacement", "error", "error in standard deviations", "counts by")
    return Table(head, tuple(rows)) if rows else None


def _source(result: StaticStiffness) -> str:
    source = result.source
    parts = [source.citation, f"Licence: {source.licence}" if source.licence else ""]
    return ". ".join(part for part in parts if part)


def _figures(result: StaticStiffness, folder: Path) -> list[PageFigure]:
    shown = [
        (
            "joints",
            "Stiffness of the joints",
            stiffness_figure(result),
            "An arrow at the end of an interval: a rigid joint is not excluded.",
        ),
        (
            "prediction",
            "Displacement measured and predicted",
            prediction_figure(result),
            "Every pose is predicted by the stiffness that the other poses give.",
        ),
        (
            "poses",
            "Error by pose",
            poses_figure(result),
            "Length of the error vector. Red poses do not fit the others and count less.",
        ),
    ]
    if result.torque_dependence.models:
        shown.append(
            (
                "models",
                "Does compliance depend on torque?",
                models_figure(result),
                "Green models depend on torque, blue ones do not. More parameters always lower "
                "the error on the poses fitted to; only the error on poses left out counts.",
            )
        )
    if result.torque_dependence.secant:
        shown.append(
            (
                "secant",
                "Stiffness over torque",
                secant_figure(result),
                "Torque over wind-up by the torque-dependent model that the poses support.",
            )
        )
    return [_figure(*each, folder) for each in shown]


def _figure(name: str, title: str, figure: Figure, caption: str, folder: Path) -> PageFigure:
    svg = to_svg(figure, f"static_{name}", title)
    atomic_write(folder / f"static_{name}.svg", svg)
    atomic_write(folder / f"static_{name}.png", to_png(figure))
    return page_figure(svg, caption, title)
