"""What docs/findings.md and docs/evidence.md say is what the runs in results/ gave."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kendalltau
from study_files import texts_of

from analysis import findings as analysis
from analysis.comparisons import has_depth, is_two_sided
from analysis.placements import ELEVATION, FRONT, HIDDEN, MODEL, PIXELS
from analysis.protocol import PREREGISTERED, RULE, held, means, predicted
from needlehoop.study.report.tables import rewards
from needlehoop.study.stats.run import TRAINING

ROOT = Path(__file__).parents[2]
PAGES = {name: (ROOT / "docs" / name).read_text() for name in ("findings.md", "evidence.md")}
PAGE = "\n".join(PAGES.values())
WORDS = " ".join(PAGE.split())


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
    assert f"τ-b {tau:.2f} over the {len(longer)} sets, p = {p:.2f}" in WORDS


def test_sentences_on_cameras_have_the_tables_numbers():
    added = [row["success, points (95 %)"] for row in rows_of("protocol_traits")]
    view, depth, labels = (cell.replace("+", "") for cell in added[:3])
    points = view.replace(" (", " points of success (")
    assert f"a front and a side view beat the default view by {points}" in WORDS
    depth, labels = (cell.replace(" (", ", ") for cell in (depth, labels))
    assert f"Depth ({depth} and segmentation ({labels} are not shown to add" in WORDS
    found = rows_of("protocol")
    mean, sampled = (
        {row["cameras"]: row[of].split()[0] for row in found}
        for of in ("mean (95 %), %", "sampled, %")
    )
    seeds = {len(row["threaded by seed, %"].split(", ")) for row in found}
    assert seeds == {5}
    assert "All sets have their five seeds" in WORDS
    best = [*mean][:3]
    assert all("seg_front" in name for name in best)
    assert f"three best sets ({mean[best[-1]]} to {mean[best[0]]} of 100) have it in front" in WORDS
    beaten = "chance of a run of the best set to beat it (95 %)"
    lows = [float(row[beaten].partition("(")[2].split()[0]) for row in found]
    assert [low < 0.5 for low in lows] == [True] * 3 + [False] * (len(lows) - 3)
    assert f"`rgb_default` threads in {mean['rgb_default']}, `segdep_front`" in WORDS
    assert f"shaded by depth) in {mean['segdep_front']}." in WORDS
    said = "sampled actions do not: `segdep_side` threads in {} and {}."
    assert said.format(mean["segdep_side"], sampled["segdep_side"]) in WORDS
    ends = {row["cameras"]: row["1.5 M: threaded, %"] for row in rows_of("results")}
    two, one = (
        sorted(int(end) for name, end in ends.items() if end and is_two_sided(name) is sides)
        for sides in (True, False)
    )
    assert (two, len(one)) == ([100] * 9, 5)
    assert f"of 100, the sets with one view in {one[0]} to {one[-1]}." in WORDS


def test_sentences_on_renderings_have_the_tables_numbers():
    added = {
        (row["colour alone"], row["instead"]): int(row["adds, points"])
        for row in rows_of("protocol_changes")
    }
    one, two = "rgb_default", "rgb_front+rgb_side"
    depth, labels = added[one, "dep_default"], added[one, f"{one}+seg_default"]
    assert f"depth adds {depth} points and segmentation beside colour {labels}." in WORDS
    depths = ("rgb_front+dep_side", "dep_front+rgb_side", "dep_front+dep_side")
    assert f"In two views depth adds {max(added[two, name] for name in depths)} at most" in WORDS
    front = sorted(added[two, name] for _, name in added if name.startswith("seg_front"))
    assert f"segmentation in front adds {front[0]} to {front[-1]}" in WORDS
    (side,) = {added[two, f"{other}_front+seg_side"] for other in ("rgb", "dep")}
    assert f"at the side alone it costs {-side}." in WORDS


def test_sentences_on_predictions_have_the_tables_numbers():
    found = {row["prediction"]: row for row in rows_of("protocol_foretold")}
    papers, claude, probe, rule = (found[who] for who in (*PREREGISTERED, RULE))
    assert f"It agrees with success by τ-b {rule['τ-b']} (1:" in WORDS
    assert f"can agree with success by {rule['τ-b']} at most" in WORDS
    assert f"vision-language model agrees by {papers['τ-b']}" in WORDS
    assert f"with pictures (`claude`) by {claude['τ-b']}, the" in WORDS
    assert f"read off images, by {probe['τ-b']}." in WORDS
    ps = [one["p beyond the rule"] for one in (papers, claude, probe)]
    assert "None was shown to know more than the rule (p {}, {} and {})".format(*ps) in WORDS
    assert min(map(float, ps)) > 0.05
    lost = [one["regret, points"] for one in (probe, claude, rule)]
    said = (
        "probe puts first loses {} points of success against the best (by probe scores that nearly"
        " tie), `claude`'s {}, a random one of those that the rule puts first {}."
    )
    assert said.format(*lost) in WORDS
    imitated = {row["prediction"]: row["1.5 M"] for row in rows_of("foretold")}["imitation"]
    assert f"does not show more than the rule ({imitated.split(', ')[1]};" in WORDS
    first = analysis.runs("protocol")
    first = first[first["seed"] == first["seed"].min()]
    _, p, _ = held("probe", predicted(analysis.foretellers())["probe"], means(first))
    assert f"first seed alone, the probe did know more than the rule (p {p:.2f})" in WORDS


def test_sentences_on_survival_have_the_tables_numbers():
    found = {
        (row["trained"], row["tested under"], row["prediction"]): row["ρ (95 %)"]
        for row in rows_of("survival_foretold")
    }
    mean = found["undisturbed", "mean over axes", "Q1"].replace(")", "; two of five seeds)")
    assert f"each by itself, by ρ {mean}" in WORDS
    axes = rows_of("survival_axes")
    left, under = (
        {row["axis"]: row[f"trained {how}, %"] for row in axes}
        for how in ("undisturbed", "under moderate")
    )
    turn, shift, every = (
        left[axis] + "{}" + f" (ρ {found['undisturbed', axis, 'Q1'].split()[0]})"
        for axis in ("camera.turn", "camera.shift", "all")
    )
    said = f"a turned camera leaves {turn}, a shifted one {shift}, all at once {every}."
    assert said.format(f" of {left['none']} %", "", "") in WORDS
    plain, trained = (
        analysis.survived().query(f"disturb == '{how}'")["success"].mean() * 100
        for how in ("none", "moderate")
    )
    said = f"agents thread in {under['none']} % undisturbed, {trained:.0f} under the 27"
    assert f"{said} (not {plain:.0f}) and {under['all']} under all at once" in WORDS
    cheap = [axis for axis in left if int(left["none"]) - int(left[axis]) < 5]
    assert len(cheap) > len(left) / 2


def test_sentences_on_the_peg_transfer_have_the_tables_numbers():
    found = rows_of("pegs")
    assert {len(row["placed by seed, %"].split(", ")) for row in found} == {3}
    assert "Each has its three seeds" in WORDS
    view = rows_of("pegs_traits")[0]["success, points (95 %)"].replace("+", "")
    said = f"a front and a side view add {view.replace(' (', ' points (')}."
    assert said in WORDS
    foretold = {row["prediction"]: row for row in rows_of("pegs_foretold")}
    said = "The rule agrees with success by τ-b {}, `claude`'s order by {} (p {})."
    claude = foretold["claude"]
    said = said.format(foretold[RULE]["τ-b"], claude["τ-b"], claude["p beyond the rule"])
    assert said in WORDS
    assert float(claude["p beyond the rule"]) > 0.05
    placed = {row["cameras"]: int(row["mean (95 %), %"].split()[0]) for row in found}
    blind, deep, two = (
        " to ".join(str(of(own)) for of in (min, max))
        for own in (
            [placed[name] for name in placed if not (is_two_sided(name) or has_depth(name))],
            [placed[name] for name in placed if has_depth(name) and not is_two_sided(name)],
            [placed[name] for name in placed if is_two_sided(name)],
        )
    )
    said = f"in {blind} of 100, one with depth in {deep}, two views in {two}."
    assert said in WORDS


def test_sentences_on_the_standard_peg_transfer_have_its_runs_numbers():
    placed = {name: round(100 * own) for name, own in means(analysis.runs("peg_standard")).items()}
    poor = [name for name in placed if not (is_two_sided(name) or has_depth(name))]
    rest = [placed[name] for name in placed if name not in poor]
    ends = f"{min(rest)} to {max(rest)}"
    said = ", ".join(f"`{name}` in {placed[name]}" for name in sorted(poor))
    sets = f"{len(rest)} of {len(placed)} sets placed the block in {ends} of 100 there"
    assert f"{sets}, {said}" in WORDS


def test_sentences_on_places_have_the_tables_numbers():
    for study, said in (
        ("placements", "Three seeds order the single cameras alike (ρ {:.2f}),"),
        (analysis.PAIRS, "and the pairs (ρ {:.2f})."),
    ):
        runs = analysis.runs(study).pivot(index="cameras", columns="seed", values="success")
        assert runs.shape == (20, 3)
        alike = runs.corr("spearman").to_numpy()[~np.eye(runs.shape[1], dtype=bool)].mean()
        assert said.format(alike) in WORDS
    said, rules = {}, []
    for marker in ("placements", "pairs_foretold"):
        found = {row["prediction"]: row for row in rows_of(marker)}
        rho = {who: found[who]["ρ (95 %)"].split()[0] for who in (MODEL, PIXELS, HIDDEN, ELEVATION)}
        said[marker] = f"{rho.pop(MODEL)} (p {found[MODEL]['p']})"
        rules += map(float, rho.values())
        assert float(found[MODEL]["p"]) > 0.05
    singles, pairs = said.values()
    assert (
        f"agrees with success by ρ {singles} for single cameras and by {pairs} for pairs,"
        f" three rules by {max(rules):.2f} at most" in WORDS
    )
    (front,) = (row for row in rows_of("placements") if row["prediction"] == FRONT)
    assert f"better near the front (ρ {front['ρ (95 %)'].split()[0]})." in WORDS


def test_sentences_on_pairs_have_the_tables_numbers():
    single, pair = (means(analysis.runs(name)) for name in ("placements", analysis.PAIRS))
    mean, both = (100 * np.mean([*own.values()]) for own in (single, pair))
    best = f"{100 * max(single.values()):.0f}"
    assert f"thread in {mean:.0f} of 100 episodes on average, the best in {best}." in WORDS
    least, most = (100 * of(pair.values()) for of in (min, max))
    assert f"20 random pairs of them thread in {both:.0f} ({least:.0f} to {most:.0f})," in WORDS
    gained = [own - max(single[one] for one in name.split("+")) for name, own in pair.items()]
    assert f"each at least {int(100 * min(gained))} points above the better one alone" in WORDS


def listed(cells: list[str]) -> str:
    """As a sentence has them."""
    return " and ".join([", ".join(cells[:-1]), cells[-1]])


def test_sentences_on_writers_have_the_tables_numbers():
    rows = rows_of("writers")
    assert {len(row["threaded by run, %"].split(", ")) for row in rows} == {5}
    mean, told, shown = (row["mean (95 %), %"].split()[0] for row in rows)
    more = [row["more than human, points (95 %)"].replace("+", "") for row in rows[1:]]
    text, image = (one.replace(" (", " points, ").strip(")") for one in more)
    assert all(float(one.split("(")[1].split()[0]) <= -5 for one in more)
    assert "`claude` is not shown to do it as well as we did." in WORDS
    assert f"our reward threads in {mean} of 100, `claude`'s five programs told by" in WORDS
    assert f"told by text in {told} ({text})," in WORDS
    assert f"five shown an image in {shown} ({image.replace(' points', '')})." in WORDS
    runs = analysis.runs("protocol_rewards")
    programs, ours = runs.query("reward != 'human'"), runs.query("reward == 'human'")["success"]
    failed, works = programs.query("lifted == 0"), programs.query("lifted > 0")["success"]
    assert (len(failed), len(works)) == (5, 5)
    ends, own = (f"{100 * one.min():.0f} to {100 * one.max():.0f}" for one in (works, ours))
    never = "with five of the ten the needle is never lifted; with the others it is threaded in"
    assert f"{never} {ends}, with ours in {own}." in WORDS
    grasped = listed([f"{100 * share:.0f}" for share in sorted(failed["grasped"])])
    assert f"agents grasp the needle in {grasped} of 100 episodes and lift it in none" in WORDS


REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")


def test_sentences_on_rewards_have_the_runs_numbers():
    of = {
        (row["cameras"], row["reward"]): row
        for row in texts_of(rewards(analysis.study("rewards")))
        if row["cameras"] in REWARDED
    }

    def said(reward: str, column: str) -> list[str]:
        return [of[cameras, reward][column] for cameras in REWARDED]

    claudes = [row for (_, reward), row in of.items() if reward.startswith("claude")]
    assert {row["cheat, %"] for row in claudes} == {"0"}
    least, *others = sorted(int(row["success, %"]) for row in claudes)
    assert others == [100] * 5
    assert f"`claude`'s four rewards thread in {least} to 100, as does ours," in WORDS
    assert {row["success, %"] for (_, reward), row in of.items() if reward == "human"} == {"100"}
    ends, seen = (said(f"VLM, text{more}", "success, %") for more in ("", " + image"))
    papers = sorted(map(int, ends + seen))
    assert f"the paper's six in {papers[0]} to {papers[-1]}." in WORDS
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
    assert said.format(*returns) in WORDS


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
    assert said in WORDS
