"""All figures of a study, as files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from needlehoop.runs.reading import UnreadableError
from needlehoop.study.data.findings import Findings
from needlehoop.study.data.media import check_picture
from needlehoop.study.render.charts import final_values, success_and_cheats, time_to_threshold
from needlehoop.study.render.curves import MissingDataError, learning_curves, reward_comparison
from needlehoop.study.render.style import save, styled
from needlehoop.study.report.rankings import ranking_chart
from needlehoop.study.stats.costs import cost_and_regret

CONTACT_SHEET = "contact_sheet.png"
"""In a study's folder; only the simulator can make one, so it is copied."""

_DRAWN: dict[str, tuple[Callable[[Findings], Figure], str]] = {
    "cost_and_regret": (
        cost_and_regret,
        "What choosing cameras by each prediction costs, and what it loses: the return of the best"
        " set less that of the predicted best, mean over the lists that it ranked (dots: each"
        " list; line: 95 % over other seeds of what was measured). Lower and further left is"
        " better. Dashed: a set chosen blindly. One seed: of what was measured, to choose by.",
    ),
    "learning_curves": (
        learning_curves,
        "Return over training, as the paper's Figure 6: interquartile mean over seeds, with 95 %"
        " bootstrap intervals where there are three; each point is the mean over the last 4 % of"
        " the longest run. Thin: fewer seeds have come so far. Training samples its actions, so a"
        " curve ends below the final return, which is of the mean action.",
    ),
    "rewards": (
        reward_comparison,
        "Rewards compared, as the paper's Figure 7. Left: each curve is in its own reward's points."
        " Right, what compares across rewards: the share of training episodes that thread, of"
        " sampled actions, and of evaluations, of the mean action, which may stop short where"
        " noise still carries the needle through.",
    ),
    "final_values": (
        final_values,
        "Combinations by final return, with success; interquartile means, and 95 % intervals: of"
        " returns over three seeds or more, of success over episodes where there are fewer.",
    ),
    "rankings": (
        ranking_chart,
        "Rankings side by side: places that were foretold and measured, in each list; darker is"
        " better. The rows stand as measured.",
    ),
    "success_and_cheats": (
        success_and_cheats,
        "Success against cheating: needle threaded, or goal touched without threading.",
    ),
    "time_to_threshold": (
        time_to_threshold,
        "Steps until half of the training episodes succeed, over five buffers; a dot per run.",
    ),
}


@dataclass(frozen=True)
class Drawn:
    """A figure's files, or why there are none."""

    name: str
    caption: str
    files: tuple[Path, ...]
    missing: str | None


def draw(findings: Findings, folder: Path) -> list[Drawn]:
    """Draw everything there is data for, as PNG and SVG.

    Args:
        findings: of a study, or of the paper.
        folder: for the files; made where missing. Older figures there are replaced, or
            removed where there is nothing to draw any more.
    """
    drawn = [_contact_sheet(findings, folder)]
    for name, (figure, caption) in _DRAWN.items():
        for suffix in (".png", ".svg"):
            (folder / f"{name}{suffix}").unlink(missing_ok=True)
        try:
            with styled():
                files = save(figure(findings), folder / name)
        except MissingDataError as error:
            drawn.append(Drawn(name, caption, (), str(error)))
        else:
            drawn.append(Drawn(name, caption, tuple(files), None))
    return drawn


def _contact_sheet(findings: Findings, folder: Path) -> Drawn:
    caption = "Start and goal in every view and rendering, as the paper's Figure 2."
    if findings.study is None:
        return Drawn("contact_sheet", caption, (), "the paper's pictures are not ours to ship")
    source = findings.study.folder / CONTACT_SHEET
    how = f"make it with: needlehoop snapshot out={source}"
    if not source.exists():
        return Drawn("contact_sheet", caption, (), how)
    try:
        check_picture(source)
    except UnreadableError as error:
        return Drawn("contact_sheet", caption, (), f"{source} {error}; {how} overwrite=true")
    folder.mkdir(parents=True, exist_ok=True)
    copy = folder / CONTACT_SHEET
    shutil.copyfile(source, copy)
    return Drawn("contact_sheet", caption, (copy,), None)
