"""What docs/findings.md and docs/evidence.md say is what the runs in results/ gave."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kendalltau, spearmanr
from study_files import texts_of

from analysis import findings as analysis
from analysis.comparisons import has_depth, is_two_sided
from analysis.placements import ELEVATION, HIDDEN, MODEL, PIXELS, correlations
from analysis.protocol import PREREGISTERED, RULE, held, means, predicted
from needlehoop.study.render.table import Column
from needlehoop.study.report.tables import rewards
from needlehoop.study.stats.run import TRAINING

ROOT = Path(__file__).parents[2]
PAGES = {name: (ROOT / "docs" / name).read_text() for name in ("findings.md", "evidence.md")}
PAGE = "\n".join(PAGES.values())


def cells_of(marker: str) -> list[list[str]]:
    """The pages' table under a comment that names its source, its head first."""
    assert PAGE.count(f"<!-- {marker} -->\n") == 1
    lines = PAGE.partition(f"<!-- {marker} -->\n")[2].splitlines()
    rows = lines[: lines.index("")]
    head, _, *rest = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows]
    return [head, *rest]


def rows_of(marker: str) -> list[dict[str, str]]:
    """The same as rows by the head's names."""
    head, *rows = cells_of(marker)
    return [dict(zip(head, row, strict=True)) for row in rows]


def test_a_refilled_page_is_the_page():
    page = PAGES["evidence.md"]
    assert analysis.refilled(page) == page
    with pytest.raises(ValueError, match=r"evidence\.md: no table claims"):
        analysis.refilled(page.replace("<!-- claims", "<!-- nothing"))


def test_the_findings_fit_one_screen():
    # Of some fifty lines at 120 characters.
    assert PAGES["findings.md"].count("\n") <= 50


def test_success_by_seed_is_what_evaluations_say():
    shown = {row["cameras"]: row["by seed"] for row in rows_of("results")}
    seeds: dict[str, list[str]] = {}
    for path in sorted((ROOT / "results" / "fast").glob("*/*/*/evaluation.json")):
        share = json.loads(path.read_text())["success"]
        seeds.setdefault(path.parts[-4], []).append(f"{100 * share:.0f}")
    assert shown == {cameras: ", ".join(own) for cameras, own in seeds.items()}


def test_the_fast_protocol_foretells_the_papers_as_the_page_says():
    fast, longer = (analysis.study(study).middles(TRAINING) for study in ("fast", "table2"))
    tau, p = kendalltau([fast[cameras] for cameras in longer], [*longer.values()])
    assert f"τ-b {tau:.2f} over the {len(longer)} sets, p = {p:.2f}" in " ".join(PAGE.split())


def test_sentences_on_cameras_have_the_tables_numbers():
    added = [row["success, points (95 %)"] for row in rows_of("protocol_traits")]
    view, depth, labels = (cell.replace("+", "") for cell in added[:3])
    words = " ".join(PAGE.split())
    assert f"a front and a side view add {view.replace(' (', ' points of success (')}" in words
    assert f"Depth adds {depth} and segmentation {labels}" in words
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"A front and a side camera add {view.split()[0]} points of success" in readme
    found = rows_of("protocol")
    mean, sampled = (
        {row["cameras"]: row[of].split()[0] for row in found}
        for of in ("mean (95 %), %", "sampled, %")
    )
    seeds = {len(row["threaded by seed, %"].split(", ")) for row in found}
    assert seeds == {5}
    assert "All sets have their five seeds" in words
    best = next(iter(mean))
    assert f"`{best}`, threads in {mean[best]} of 100" in words
    assert f"`rgb_default` in {mean['rgb_default']}." in words
    said = "`segdep_side` threads in {} of 100 with the one, in {} with the other"
    assert said.format(mean["segdep_side"], sampled["segdep_side"]) in words
    ends = {row["cameras"]: row["1.5 M: threaded, %"] for row in rows_of("results")}
    two, one = (
        sorted(int(end) for name, end in ends.items() if end and is_two_sided(name) is sides)
        for sides in (True, False)
    )
    assert (two, len(one)) == ([100] * 9, 5)
    assert f"with one view in {one[0]} to {one[-1]}" in words


def test_sentences_on_predictions_have_the_tables_numbers():
    found = {row["prediction"]: row for row in rows_of("protocol_foretold")}
    words = " ".join(PAGE.split())
    papers, claude, probe, rule = (found[who] for who in (*PREREGISTERED, RULE))
    assert f"on the wide task by τ-b {rule['τ-b']}." in words
    assert f"The paper's model agrees by {papers['τ-b']}" in words
    assert f"shown pictures) by {claude['τ-b']}, the" in words
    assert f"read off images, by {probe['τ-b']}." in words
    ps = [one["p beyond the rule"] for one in (papers, claude, probe)]
    assert "None was shown to know more than the rule (p {}, {} and {})".format(*ps) in words
    assert min(map(float, ps)) > 0.05
    lost = [one["regret, points"] for one in (probe, claude, rule)]
    said = (
        "probe puts first loses {} points of success, `claude`'s {}, and one that the rule allows"
    )
    assert f"{said} {{}}".format(*lost) in words
    imitated = {row["prediction"]: row["1.5 M"] for row in rows_of("foretold")}["imitation"]
    assert f"does not show more than the rule ({imitated.split(', ')[1]};" in words
    first = analysis.runs("protocol")
    first = first[first["seed"] == first["seed"].min()]
    _, p, _ = held("probe", predicted(analysis.foretellers())["probe"], means(first))
    assert f"first seed alone, the probe did know more than the rule (p {p:.2f})" in words


def test_sentences_on_survival_have_the_tables_numbers():
    words = " ".join(PAGE.split())
    sets = rows_of("survival")
    rho = rows_of("survival_foretold")[0]["ρ (95 %)"].replace(")", "; two seeds were tested)")
    assert f"each by itself, by ρ {rho}" in words
    kept = {row["cameras"]: row["mean over axes, %"] for row in sets}
    best = sets[0]["cameras"]
    assert (
        f"`{best}` then threads in {kept[best]} %, `rgb_default` in {kept['rgb_default']}." in words
    )
    left = {row["axis"]: row["trained undisturbed, %"] for row in rows_of("survival_axes")}
    assert [*left][:3] == ["all", "camera.turn", "camera.shift"]
    said = "they leave {camera.turn} and {camera.shift} % where undisturbed episodes have {none}"
    for axis in ("camera.turn", "camera.shift", "none"):
        said = said.replace(f"{{{axis}}}", left[axis])
    assert said in words
    under = {row["axis"]: row["trained under moderate, %"] for row in rows_of("survival_axes")}
    mean = analysis.survived().query("disturb == 'moderate'")["success"].mean()
    assert f"All disturbances at once leave {left['all']} %." in words
    robust = ROOT / "results" / "robust" / "dep_front+seg_side"
    kept = [pd.read_csv(path) for path in sorted(robust.glob("expert+*stack-3/*/stress.csv"))]
    which = "severity == 3 and axis not in ['none', 'all']"
    each = " and ".join(f"{100 * own.query(which)['success'].mean():.0f}" for own in kept)
    assert f"leave [{each} %](robustness.md#what-it-shows-so-far) under each axis" in words
    assert f"thread in {under['none']} % undisturbed and {100 * mean:.0f} under each axis" in words
    assert f"all at once they do better, in {under['all']} %." in words


def test_sentences_on_the_peg_transfer_have_the_tables_numbers():
    words = " ".join(PAGE.split())
    found = rows_of("pegs")
    assert {len(row["placed by seed, %"].split(", ")) for row in found} == {1}
    assert "So far each has one of its three seeds" in words
    placed = {row["cameras"]: int(row["placed by seed, %"]) for row in found}
    poor = [name for name in placed if not (is_two_sided(name) or has_depth(name))]
    rest = [placed[name] for name in placed if name not in poor]
    said = f"{len(rest)} of {len(placed)} sets place the block in {min(rest)} to {max(rest)} of 100"
    assert said in words
    assert max(placed[name] for name in poor) < min(rest)
    names = listed([f"`{name}` ({placed[name]})" for name in sorted(poor)])
    assert f"The other three, {names}, see one view and no depth." in words
    view = rows_of("pegs_traits")[0]["success, points (95 %)"].replace("+", "")
    assert f"A second view adds {view.replace(' (', ' points (')}" in words
    needle = pd.DataFrame({"needle": means(analysis.runs("protocol"))})
    (_, rho, *_), _ = correlations(needle, analysis.runs(analysis.PEGS))
    assert f"Success with the needle agrees by ρ {Column('ρ', form='.2f').text(rho)}" in words
    foretold = {row["prediction"]: row for row in rows_of("pegs_foretold")}
    p = foretold["claude"]["p beyond the rule"]
    assert f"order knows no more than the rule (p {p})" in words
    assert float(p) > 0.05


def test_sentences_on_places_have_the_tables_numbers():
    rows = rows_of("places")
    words = " ".join(PAGE.split())
    assert {row["camera"]: row["azimuth, °"] for row in rows}[rows[0]["camera"]] == "24"
    runs = analysis.runs("placements").pivot(index="cameras", columns="seed", values="success")
    best = runs.mean(axis=1).max()
    assert f"24 degrees to the left of the front, in {100 * best:.0f}." in words
    assert runs.loc["rgb_p08"].max() == 0
    alike = runs.corr("spearman").to_numpy()[~np.eye(runs.shape[1], dtype=bool)].mean()
    assert f"Three seeds order the single cameras alike (ρ {alike:.2f})" in words
    assert runs.shape[1] == 3
    said, rules = {}, []
    for marker in ("placements", "pairs_foretold"):
        found = {row["prediction"]: row for row in rows_of(marker)}
        rho = {who: found[who]["ρ (95 %)"].split()[0] for who in (MODEL, PIXELS, HIDDEN, ELEVATION)}
        said[marker] = f"{rho.pop(MODEL)} (p {found[MODEL]['p']})"
        rules += map(float, rho.values())
    singles, pairs = said.values()
    assert (
        f"agrees with success by ρ {singles} for single cameras and by {pairs} for pairs,"
        f" three rules by {max(rules):.2f} at most" in words
    )


def test_sentences_on_pairs_have_the_tables_numbers():
    words = " ".join(PAGE.split())
    single, pair = (means(analysis.runs(name)) for name in ("placements", analysis.PAIRS))
    mean, both = (100 * np.mean([*own.values()]) for own in (single, pair))
    assert f"thread in {mean:.0f} of 100 episodes on average" in words
    assert f"20 random pairs of the same cameras thread in {both:.0f}," in words
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"succeed in {both:.0f} of 100 episodes there, single ones in {mean:.0f}." in readme
    gained = [own - max(single[one] for one in name.split("+")) for name, own in pair.items()]
    assert f"each at least {100 * min(gained):.0f} points above the better" in words
    seeds = {len(row["threaded by seed, %"].split(", ")) for row in rows_of("pairs")}
    assert seeds == {2}
    assert "The random pairs have two seeds of three so far" in words
    one, other = analysis.runs(analysis.PAIRS).groupby("seed")
    alike = spearmanr(*(own.sort_values("cameras")["success"] for _, own in (one, other)))
    assert f"two the pairs (ρ {alike.statistic:.2f})" in words


def listed(cells: list[str]) -> str:
    """As a sentence has them."""
    return " and ".join([", ".join(cells[:-1]), cells[-1]])


REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")


def test_sentences_on_rewards_have_the_runs_numbers():
    of = {
        (row["cameras"], row["reward"]): row
        for row in texts_of(rewards(analysis.study("rewards")))
        if row["cameras"] in REWARDED
    }
    words = " ".join(PAGE.split())

    def said(reward: str, column: str) -> list[str]:
        return [of[cameras, reward][column] for cameras in REWARDED]

    against = {row["reward"]: row["human's points (95 %)"] for row in rows_of("writers")}
    assert against["claude, text, against human"] == "-0.09 (-0.17 to -0.01)"
    assert "0.09 points below the human one from text (0.01 to 0.17)" in words
    assert against["claude, text + image, against human"] == "-0.10 (-0.21 to +0.02)"
    assert "and 0.10 from text and images (-0.02 to 0.21)" in words
    claudes = [row for (_, reward), row in of.items() if reward.startswith("claude")]
    assert {row["cheat, %"] for row in claudes} == {"0"}
    least, *others = sorted(int(row["success, %"]) for row in claudes)
    assert others == [100] * 5
    assert f"five of six agents thread in 100 of 100, one in {least}" in words
    ends = said("VLM, text", "success, %")
    assert f"the mean action ends at {listed(ends)} of 100" in words
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"agents thread in {least} to 100 of 100" in readme
    assert f"they end at {listed(ends)} of 100" in readme
    for success, cheat in zip(ends, said("VLM, text", "cheat, %"), strict=True):
        assert int(success) + int(cheat) == 100


def test_the_papers_text_reward_is_unlearnt_as_the_page_says():
    at_best, last = [], []
    for path in (ROOT / "results" / "rewards").glob("*/vlm_text/seed0/evaluations.csv"):
        with path.open(newline="") as file:
            rows = {int(row["step"]): row for row in csv.DictReader(file)}
        at_best.append(rows[1_024_000])
        last.append(rows[max(rows)])
    assert {(row["episodes"], float(row["success"])) for row in at_best} == {("20", 1.0)}
    hovering = max(last, key=lambda row: float(row["cheat"]))
    threading = at_best[last.index(hovering)]
    said = "the hoop's very centre pays {:.1f} with it, to go on through it {:.1f}"
    returns = [float(row["return"]) for row in (hovering, threading)]
    assert said.format(*returns) in " ".join(PAGE.split())


def test_the_last_seed_alone_is_foretold_as_the_page_says():
    over_training = {}
    for path in (ROOT / "results" / "fast").glob("*/vlm_text/seed2/metrics.csv"):
        with path.open(newline="") as file:
            returns = [float(row["return"]) for row in csv.DictReader(file) if row["return"]]
        over_training[path.parts[-4]] = sum(returns) / len(returns)
    predictions = [one for one in analysis.study("fast").predictions if len(one.lists) == 3]
    assert len(predictions) == 6
    means = []
    for one in predictions:
        taus = [
            kendalltau(*zip(*[(own[name], over_training[name]) for name in own], strict=True))
            for own in one.lists.values()
        ]
        means.append(sum(tau.statistic for tau in taus) / len(taus))
    said = f"with that seed alone they agree by {min(means):.2f} to {max(means):.2f}"
    assert said in " ".join(PAGE.split())
