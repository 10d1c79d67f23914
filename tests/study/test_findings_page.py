"""What docs/findings.md and docs/evidence.md say is what the runs in results/ gave."""

import csv
import io
import json
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from scipy.stats import kendalltau

from needlehoop.study.data import paper
from needlehoop.study.data.combinations import REWARDS, label
from needlehoop.study.data.findings import study_findings
from needlehoop.study.render.curves import steps_to_share
from needlehoop.study.report.table import Table
from needlehoop.study.report.tables import all_tables
from needlehoop.study.stats.claims import CLAIMS
from needlehoop.study.stats.reliability import OTHER_SEEDS

ROOT = Path(__file__).parents[2]
PAGES = {name: (ROOT / "docs" / name).read_text() for name in ("findings.md", "evidence.md")}
PAGE = "\n".join(PAGES.values())
SOON = "return over training"


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


@cache
def tables(study: str) -> dict[str, Table]:
    return {one.name: one for one in all_tables(study_findings(ROOT / "results" / study))}


def table(study: str, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(tables(study)[name].csv())))


@pytest.mark.parametrize(
    ("name", "common", "columns"),
    [
        ("effects", ["trait"], ["return (95 %)", "return over training (95 %)"]),
        (
            "claims",
            ["the paper says", "its returns"],
            ["difference, 95 %", "return over training: difference, 95 %"],
        ),
    ],
)
def test_both_protocols_stand_beside_each_other(name, common, columns):
    fast = table("fast", name)
    there = {row[common[0]]: row for row in table("table2", name)}
    assert name == "effects" or len(fast) == len(CLAIMS)
    # Of claims whose sets have not all been trained the page says nothing.
    longer = [there.pop(row[common[0]], dict.fromkeys(columns, "")) for row in fast]
    assert not there
    head, *shown = cells_of(name)
    steps = [(f"{steps}: ", study) for steps, study in (("0.5 M", fast), ("1.5 M", longer))]
    names = ["return (95 %)", "over training (95 %)"]
    assert head == [*common, *(before + one for before, _ in steps for one in names)]
    assert shown == [
        [*(fast[i][one] for one in common), *(own[i][one] for _, own in steps for one in columns)]
        for i in range(len(fast))
    ]


def test_a_refilled_page_is_the_page():
    spec = spec_from_file_location("refill", ROOT / "docs" / "refill.py")
    assert spec is not None
    assert spec.loader is not None
    refill = module_from_spec(spec)
    spec.loader.exec_module(refill)
    assert set(refill.TABLES) == set(PAGES)
    for name, page in PAGES.items():
        assert refill.refilled(name, page) == page
    with pytest.raises(ValueError, match=r"findings\.md: no table sets"):
        refill.refilled("findings.md", PAGE.replace("<!-- sets", "<!-- nothing"))


def test_the_findings_tables_are_drawn_from_the_evidences():
    evidence = {row["cameras"]: row for row in rows_of("results")}
    sets = rows_of("sets")
    assert {row["cameras"] for row in sets} == set(evidence)
    assert all(row.items() <= evidence[row["cameras"]].items() for row in sets)
    soon = [float(row["over training"]) for row in sets]
    assert soon == sorted(soon, reverse=True)
    agreement = {row["prediction"]: row for row in rows_of("agreement")}
    regret = {row["chosen by"]: row for row in rows_of("regret")}
    foretold = rows_of("foretold")
    assert [row["prediction"] for row in foretold] == [*regret]
    for row in foretold:
        who = row.pop("prediction")
        lost = {name.removeprefix("regret: "): row.pop(name) for name in [*row] if "reg" in name}
        lost["core-minutes"] = row.pop("core-minutes")
        assert len(lost) == 4
        assert lost.items() <= regret[who].items()
        assert list(row) == ["0.5 M, over training", "1.5 M", "the paper's"]
        assert row.items() <= agreement.get(who, dict.fromkeys(row, "")).items()


def test_the_findings_fit_two_screens():
    # Of some fifty lines each, at 120 characters; a row of a table is one.
    assert PAGES["findings.md"].count("\n") <= 100


def test_the_ranking_on_the_page_is_that_of_the_runs():
    longer = {row["cameras"]: row for row in table("table2", "results")}
    theirs = {label(cameras): f"{value:.2f}" for cameras, value in paper.measured().items()}
    imitated = {row["cameras"]: row["success, %"] for row in table("imitation", "results")}
    seeds: dict[str, list[str]] = {}
    for path in sorted((ROOT / "results" / "fast").glob("*/*/*/evaluation.json")):
        share = json.loads(path.read_text())["success"]
        seeds.setdefault(label(path.parts[-4]), []).append(f"{100 * share:.0f}")
    expected = [
        {
            "cameras": row["cameras"],
            "threaded, %": row["success, %"],
            "by seed": ", ".join(seeds[row["cameras"]]),
            "return": row["return"],
            "over training": row["return over training"],
            "cheat, %": row["cheat, %"],
            "imitated, %": imitated[row["cameras"]],
            **{
                f"1.5 M: {name}": longer.get(row["cameras"], {}).get(column, "")
                for name, column in (
                    ("threaded, %", "success, %"),
                    ("return", "return"),
                    ("over training", "return over training"),
                )
            },
            "the paper's return": theirs.get(row["cameras"], ""),
        }
        for row in table("fast", "results")
    ]
    assert set(longer) <= {row["cameras"] for row in expected}
    assert rows_of("results") == expected


def test_luck_on_the_page_is_that_of_the_runs():
    fast, imitation = (
        {row["of"]: row for row in table(study, "luck")} for study in ("fast", "imitation")
    )
    end, success, over_training = map(
        share_of, (fast["return"], fast["success, %"], fast["return over training"])
    )
    words = " ".join(PAGE.split())
    assert f"is {over_training} of returns over training, {end} of final returns" in words
    assert f"and {success} of success" in words
    assert f"Of imitation's successes it is {share_of(imitation['success, %'])}." in words
    seeds = [fast[of]["seeds needed"] for of in ("return over training", "return", "success, %")]
    assert "means of {}, {} and {} seeds".format(*seeds) in words


def share_of(row: dict[str, str]) -> str:
    share, interval = row["the cameras' share, %"], row["95 %"]
    return f"{share} % ({interval})"


def test_how_far_rankings_predict_is_what_the_tables_say():
    whole = {
        study: {tuple(row[:2]): row[2:] for row in tables(study)["agreement"].rows}
        for study in ("fast", "table2")
    }
    costs = [row for study in whole for row in table(study, "cost")]
    minutes = {row["prediction"]: row["core-minutes"] for row in costs}
    columns = {
        "0.5 M": ("fast", "measured", OTHER_SEEDS),
        "0.5 M, over training": ("fast", SOON, f"{OTHER_SEEDS}, {SOON}"),
        "1.5 M": ("table2", "measured", ""),
        "1.5 M, over training": ("table2", SOON, ""),
        "the paper's": ("table2", "the paper's measured", ""),
    }
    agreement, regret = rows_of("agreement"), rows_of("regret")
    assert list(agreement[0]) == ["prediction", *columns]
    assert list(regret[0]) == ["chosen by", "core-minutes", *columns]
    asked = {one.who for one in study_findings(ROOT / "results" / "table2").predictions}
    whos = [row["prediction"] for row in agreement]
    assert {*whos} == asked | {"the paper's measured", "one seed"}
    assert [row["chosen by"] for row in regret] == [*whos, "drawn blindly"]
    assert [row["core-minutes"] for row in regret[:-1]] == [minutes.get(who, "") for who in whos]
    for column, (study, against, others) in columns.items():
        for who, fit, loss in zip(whos, agreement, regret, strict=False):
            other = others if who == "one seed" else against
            numbers = whole[study].get((f"{who} against {other}", "all lists"))
            if numbers is None:
                assert fit[column] == loss[column] == ""
                continue
            tau, tau_range, p, _, _, _, _, lost, lost_range = numbers
            said = f"{tau} ({tau_range}), p {p}".replace(" ()", "").removesuffix(", p ")
            assert fit[column] == said
            assert loss[column] == f"{lost} ({lost_range})".replace(" ()", "")
        blind = {row["chosen blindly"] for row in table(study, "cost") if row["against"] == against}
        assert {regret[-1][column]} == blind


def test_the_fast_protocol_foretells_the_papers_as_the_page_says():
    over_training = [
        {row["cameras"]: float(row["return over training"]) for row in table(study, "results")}
        for study in ("fast", "table2")
    ]
    fast, longer = over_training
    tau, p = kendalltau([fast[cameras] for cameras in longer], [*longer.values()])
    assert f"τ-b {tau:.2f} over the {len(longer)} sets, p = {p:.2f}" in " ".join(PAGE.split())


def test_sentences_on_the_papers_protocol_have_the_tables_numbers():
    effects = {row["trait"]: row["1.5 M: over training (95 %)"] for row in rows_of("effects")}
    second_view = effects["front and side views, not the default"].replace("+", "")
    words = " ".join(PAGE.split())
    assert second_view.replace(" (", " points over training (") in words
    sooner = {row["trait"]: row["0.5 M: over training (95 %)"] for row in rows_of("effects")}
    view, depth, segmentation, two = (
        sooner[trait].replace("+", "")
        for trait in (
            "front and side views, not the default",
            "depth in a camera",
            "segmentation in a camera",
            "two cameras, not one",
        )
    )
    assert f"instead of the default {view}, segmentation in a camera {segmentation}" in words
    assert f"depth {depth}, two cameras instead of one nothing that shows, {two}." in words
    taus = {row["prediction"]: row["1.5 M"].partition(",")[0] for row in rows_of("agreement")}
    assert (
        "the probe by {probe}, `claude` by {claude}, the paper's model by {the paper's VLM}; our 51"
        " runs of 0.5 M steps by {fast protocol}, the paper's own returns by {the paper's measured}"
    ).format(**taus) in words
    *choices, blind = [float(row["1.5 M"]) for row in rows_of("regret") if row["1.5 M"]]
    assert f"{max(choices):.2f} points at most, a blind one {blind:.2f}" in words


def listed(cells: list[str]) -> str:
    """As a sentence has them."""
    return " and ".join([", ".join(cells[:-1]), cells[-1]])


REWARDED = ("DEP (F) + SEG (S)", "DEP (F) + RGB (S)", "RGB (F) + SEG (S)")


def test_rewards_on_the_page_are_those_of_the_runs():
    found = {(row["cameras"], row["reward"]): row for row in table("rewards", "rewards")}
    shown = rows_of("rewards")
    there = {reward for _, reward in found}
    assert [row["reward"] for row in shown] == [r for r in REWARDS.values() if r in there]
    assert len(shown) == 5
    for row in shown:
        reward = row.pop("reward")
        for column, cell in row.items():
            assert cell == ", ".join(found[cameras, reward][column] for cameras in REWARDED)


def test_differences_between_rewards_are_those_of_the_runs():
    whole = tables("rewards")["writers"]
    keep = [i for i, name in enumerate(whole.header) if name != "cameras"]
    head, *shown = cells_of("writers")
    assert head == [whole.header[i].replace(": difference", "") for i in keep]
    assert shown == [[row[i] for i in keep] for row in whole.rows]


def test_sentences_on_rewards_have_the_runs_numbers():
    of = {
        (row["cameras"], row["reward"]): row
        for row in table("rewards", "rewards")
        if row["cameras"] in REWARDED
    }
    words = " ".join(PAGE.split())

    def said(reward: str, column: str) -> list[str]:
        return [of[cameras, reward][column] for cameras in REWARDED]

    claudes = [row for (_, reward), row in of.items() if reward.startswith("claude")]
    assert {row["cheat, %"] for row in claudes} == {"0"}
    least, *others = sorted(int(row["success, %"]) for row in claudes)
    assert others == [100] * 5
    assert f"five of six agents thread in 100 of 100, one in {least}" in words
    points = sorted(row["human's points"] for row in claudes)
    assert f"for {points[0]} to {points[-1]} of the human reward's points" in words
    own = sorted(said("human", "human's points"))
    assert f"(its own agents: {own[0]} to {own[-1]})" in words
    soon = [
        listed(said(reward, "M steps to 90 %"))
        for reward in ("claude, text + image", "claude, text", "human")
    ]
    (more,) = (
        row["threaded over training, % (95 %)"]
        for row in rows_of("writers")
        if row["reward"] == "claude, text + image, against text alone"
    )
    more = more.removeprefix("+").replace(" (", " % more over training, ")
    said_of_image = "after {} M steps with it, {} M without ({more}, {} M with the human"
    assert said_of_image.format(*soon, more=more) in words
    ends = said("VLM, text", "success, %")
    assert f"in {listed(ends)} of 100 at the end" in words
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"as good as the human one, in {least} to 100 of 100" in readme
    assert f"and then unlearnt, to {listed(ends)} of 100" in readme
    for success, cheat in zip(ends, said("VLM, text", "cheat, %"), strict=True):
        assert int(success) + int(cheat) == 100
    images = said("VLM, text + image", "success, %")
    assert f"hovers before the hoop ({images[0]})" in words
    assert f"or cheat ({listed(images[1:])})" in words


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
    said = "at the hoop's very centre pays {:.1f}, to go on through it {:.1f}"
    returns = [float(row["return"]) for row in (hovering, threading)]
    words = " ".join(PAGE.split())
    assert said.format(*returns) in words
    assert "in 20 of 20 at 1.0 M steps" in words


def test_how_soon_half_thread_is_as_the_page_says():
    steps: dict[bool, list[float]] = {True: [], False: []}
    for result in study_findings(ROOT / "results" / "table2").ranked:
        for run in result.runs:
            half = steps_to_share(run, "success", 0.5)
            assert half is not None
            steps["side" in result.cameras].append(half / 1e6)
    pairs, one_view = (f"{min(own):.2f} to {max(own):.2f} M steps" for own in steps.values())
    words = " ".join(PAGE.split())
    assert f"Half of their training episodes thread at {pairs}" in words
    assert f"half at {one_view}" in words


def test_the_last_seed_alone_is_foretold_as_the_page_says():
    over_training = {}
    for path in (ROOT / "results" / "fast").glob("*/vlm_text/seed2/metrics.csv"):
        with path.open(newline="") as file:
            returns = [float(row["return"]) for row in csv.DictReader(file) if row["return"]]
        over_training[path.parts[-4]] = sum(returns) / len(returns)
    predictions = study_findings(ROOT / "results" / "fast").predictions
    assert len(predictions) == 4
    means = []
    for one in predictions:
        taus = [
            kendalltau(*zip(*[(own[name], over_training[name]) for name in own], strict=True))
            for own in one.lists.values()
        ]
        means.append(sum(tau.statistic for tau in taus) / len(taus))
    said = f"with that seed alone they agree by {min(means):.2f} to {max(means):.2f}"
    assert said in " ".join(PAGE.split())
