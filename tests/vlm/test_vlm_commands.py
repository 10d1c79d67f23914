"""``needlehoop vlm question``, ``rank`` and ``reward``, as typed, and their replay."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
import yaml
from needle_task import load_reward, random_signals
from PIL import Image
from vlm_server import KEY, Server, by_schema, live

from needlehoop import rewards
from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.rewards import RewardError
from needlehoop.runs.shipped import CONF, RECORDINGS
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.training import loop as page
from needlehoop.training import session
from needlehoop.vlm.conversation import Verdict
from needlehoop.vlm.writing import ProgramRules

TABLE = TASK.signals

GOOD = "reward = 9 if grasped else 0\n"
CAMS = "cams=[dep_front,seg_side]"


def judge(source: str) -> Verdict:
    refused = "import" in source
    return Verdict("line 1: import is not allowed" if refused else None, {"ok": True})


@pytest.fixture(autouse=True)
def rules(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = ProgramRules(0.0, 9.0, judge)
    monkeypatch.setattr(session, "rules_of", lambda _: rules)


@pytest.fixture(scope="module")
def studied(running: Server, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose questioning is recorded: ``results/main/vlm``."""
    results = tmp_path_factory.mktemp("studied") / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GEMINI_API_KEY", KEY)
        # Busy, an answer in the wrong form, then as asked.
        running.otherwise = by_schema
        running.script = [{"status": 429}, {"status": 500}, "no JSON"]
        assert main(["vlm", "question", *live(running), f"results={results}"]) == 0
    return results


@pytest.fixture
def study(studied: Path, tmp_path: Path) -> Path:
    shutil.copytree(studied, tmp_path / "results")
    return Path("results/main/vlm")


def lines_of(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_question_leaves_answers_a_transcript_and_pictures(study):
    found = json.loads((study / "questions.json").read_text())
    assert list(found["answers"]) == [
        *("subtasks", "suits", "goal", "lifted", "layouts", "layouts_sure", "placements")
    ]
    assert {n: len(order["places"]) for n, order in found["answers"]["placements"].items()} == {
        "1": 3,
        "2": 3,
    }
    asked = {row["question"]: row for row in rows_of(study / "questions.csv")}
    assert {row["question"] for row in rows_of(RECORDINGS / "paper/table_1.csv")} <= set(asked)
    best, meant = asked["Best view for subtask 2"], found["answers"]["suits"]["second"]
    assert (best["answer"], best["reason"]) == (meant["view"], meant["view_reason"])
    assert found["answers"]["goal"]["view"] in ("default", "front", "side")
    assert found["answers"]["goal"]["view_reason"]
    assert found["models"] == ["gemini gemini-test-001"]
    assert found["totals"] == {
        "prompts": 8,
        "tokens_in": 800,
        "tokens_out": 120,
        "prompts_without_token_count": 0,
        "invalid_answers": 1,
    }
    lines = lines_of(study / "transcript.jsonl")
    assert [line["conversation"] for line in lines] == ["question"] * 8
    assert lines[0]["attempts"] == [429, 500, 200]
    assert lines[0]["sampling"] == {"temperature": 2.0, "max_output_tokens": 16384}
    pictures = json.loads((study / "pictures.json").read_text())["pictures"]
    assert list(pictures) == ["start", "grasped", "lifted", "goal", "seen"]
    for state, shown in pictures.items():
        assert len(shown) == 12
        for camera, name in shown.items():
            with Image.open(study / "images" / f"{name}.png") as image:
                # The agent's 64 pixels are more than these; none of them is left out.
                side = 64 if state == "seen" else 16
                wide = 2 * side + 1 if camera.startswith("dep_") else side
                # Two stages stand side by side.
                wide = 2 * wide + 1 if state == "seen" else wide
                assert image.size == (wide, side)
    # Things moved, and a depth picture is no colour picture.
    assert pictures["start"]["rgb_front"] != pictures["goal"]["rgb_front"]
    assert pictures["start"]["rgb_front"] != pictures["start"]["dep_front"]


def test_everything_asked_again_offline_gives_the_same_files(study, words, server, capsys):
    assert main(["vlm", "rank", *words, "samples=2"]) == 0
    server.script[:] = [json.dumps({"explanation": "e", "program": "import os"})]
    for flavour in ("text", "image"):
        assert main(["vlm", "reward", *words, CAMS, f"flavour={flavour}"]) == 0
    said = capsys.readouterr().out
    asked = len(server.requests)

    offline = ["size=16", "study=again", f"vlm.recording={study}"]
    assert main(["vlm", "question", *offline]) == 0
    assert main(["vlm", "rank", *offline, "samples=2"]) == 0
    for flavour in ("text", "image"):
        assert main(["vlm", "reward", *offline, CAMS, f"flavour={flavour}"]) == 0
    assert len(server.requests) == asked
    # Of the last command, which was refused nothing, and of all that was asked.
    assert "this:       1 prompts, 115 tokens (100 in, 15 out), 0 invalid answers" in said
    assert f"transcript: {8 + 3 + 7 + 3 + 3} prompts" in said
    assert "2 invalid answers\nthe paper:  25 prompts, 14137 tokens" in said
    before, after = contents(study), contents(Path("results/again/vlm"))
    assert set(after) == {
        "questions.json",
        "questions.csv",
        "rankings.json",
        "rankings.csv",
        "agreement.csv",
        "totals.csv",
        *(
            f"rewards/dep_front+seg_side/{name}"
            for name in ("text.txt", "text.attempts.jsonl", "image.txt", "image.attempts.jsonl")
        ),
    }
    for name, content in after.items():
        assert content == before[name], name


def test_rank_goes_on_from_the_questioning(study, words, server):
    assert main(["vlm", "rank", *words]) == 0
    # The eight answers of the questioning are on record: three lists are all that is asked.
    turns = [len(body["contents"]) for body in server.requests]
    assert turns == [17, 19, 21]
    found = json.loads((study / "rankings.json").read_text())
    assert [len(entry["combinations"]) for entry in found["lists"]] == [5, 5, 6]
    for entry in found["lists"]:
        (places,) = entry["rankings"]
        assert [place["name"] for place in places] == entry["combinations"]
        assert all(place["reason"] for place in places)
        assert entry["agreement"] is None
    assert found["totals"]["prompts"] == 11


def test_samples_are_fresh_conversations_whose_agreement_is_in_tables(study, words, server):
    def reversed_from_the_second(schema, prompt):
        answer = json.loads(by_schema(schema))
        if "places" in answer and len(server.requests) > 4:
            answer["places"].reverse()
        return json.dumps(answer)

    # One that is no permutation goes back.
    server.script[:] = ['{"places": [{"name": "rgb_default", "reason": "r"}]}']
    server.otherwise = reversed_from_the_second
    own = "lists=[[rgb_default,dep_front+seg_side,seg_side],[rgb_front,rgb_side]]"
    assert main(["vlm", "rank", *words, own, "samples=2"]) == 0
    correction = server.requests[1]["contents"][-1]["parts"][0]["text"]
    assert "missing: dep_front+seg_side" in correction
    # Two lists, then seven questions (none goes wrong this time) and two lists.
    assert len(server.requests) == 3 + 7 + 2
    assert len(server.requests[3]["contents"]) == 1
    found = json.loads((study / "rankings.json").read_text())
    assert [entry["agreement"]["tau_b"] for entry in found["lists"]] == [-1.0, -1.0]
    assert found["lists"][0]["agreement"]["same_top"] == 0.5
    names = [line["conversation"] for line in lines_of(study / "transcript.jsonl")]
    assert names == ["question"] * 8 + ["rank"] * 3 + ["rank/2"] * 9
    ranked = rows_of(study / "rankings.csv")
    assert len(ranked) == 2 * (3 + 2)
    assert ranked[0]["sure"] == "0.75"
    last = {"list": "1", "sample": "1", "place": "3", "cameras": "seg_side", "sure": ""}
    assert ranked[2] == {**last, "reason": "because of seg_side"}
    agreed = {"list": "2", "samples": "2", "tau_b": "-1.0", "same_top": "0.5"}
    assert rows_of(study / "agreement.csv")[1] == agreed
    costs = {row["conversation"]: row["prompts"] for row in rows_of(study / "totals.csv")}
    assert costs == {"question": "8", "rank": "3", "rank/2": "9", "all": "20"}


@pytest.mark.parametrize("how", ["afresh", "names", "nothing"])
@pytest.mark.full
def test_lists_are_ranked_afresh_each_in_a_conversation_of_its_own(study, words, server, how):
    chosen = "afresh=true" if how == "afresh" else f"vlm.told={how}"
    own = [chosen, "lists=[[rgb_default,dep_front+seg_side],[rgb_front,rgb_side]]", "samples=2"]
    before = contents(study)
    assert main(["vlm", "rank", *words, *own]) == 0
    assert [len(body["contents"]) for body in server.requests] == [1] * 4
    shown = [sum("inlineData" in p for p in b["contents"][0]["parts"]) for b in server.requests]
    # The cameras of a list, at four stages and as the agent sees them.
    assert shown == [3 * 5, 2 * 5] * 2
    names = [line["conversation"] for line in lines_of(study / "transcript.jsonl")[8:]]
    assert names == [f"rank_{how}/{name}" for name in ("1", "2", "1/2", "2/2")]
    found = json.loads((study / f"rankings_{how}.json").read_text())
    assert [entry["sure"] for entry in found["lists"]] == [[[0.75]] * 2] * 2
    assert found["totals"]["prompts"] == 4
    assert not (study / "rankings.json").exists()
    # The questioning stays, and what was asked is found again.
    assert before["questions.json"] == contents(study)["questions.json"]
    assert main(["vlm", "rank", "size=16", *own]) == 0
    assert len(server.requests) == 4


def test_a_model_told_nothing_says_first_what_it_takes_the_task_to_be(
    study, words, server, monkeypatch
):
    told = dict.fromkeys(TABLE, ([0.0], [1.0]))
    monkeypatch.setattr("needlehoop.vlm.description.ranges", lambda _: told)
    server.script[:] = ['{"task": "to pick"}', *programs("import os", 3)]
    assert main(["vlm", "reward", *words, CAMS, "vlm.told=nothing"]) == 0
    assert [len(body["contents"]) for body in server.requests] == [1, 3, 5]
    rows = lines_of(study / "rewards/dep_front+seg_side/image.attempts.jsonl")
    assert [row["accepted"] for row in rows] == [False, False, True]
    assert [row["program"] for row in rows] == [None, "import os\n", "reward = 3\n"]
    assert rows[0]["answer"] == '{"task": "to pick"}'
    names = [line["conversation"] for line in lines_of(study / "transcript.jsonl")[8:]]
    assert names == ["reward/dep_front+seg_side/image/nothing"] * 3


def test_overwrite_asks_anew_and_keeps_what_there_was(study, words, server):
    assert main(["vlm", "rank", *words]) == 0
    before = contents(study)
    server.requests.clear()
    assert main(["vlm", "question", *words]) == 0
    assert server.requests == []
    assert contents(study) == before
    assert main(["vlm", "question", *words, "overwrite=true"]) == 0
    assert len(server.requests) == 7
    after = contents(study)
    assert after["transcript.1.jsonl"] == before["transcript.jsonl"]
    assert after["questions.1.json"] == before["questions.json"]
    assert after["rankings.1.json"] == before["rankings.json"]
    assert "rankings.json" not in after
    assert after["transcript.jsonl"].count(b"\n") == 7


def test_reward_shows_the_cameras_pictures_or_none(study, words, server):
    server.script[:] = [json.dumps({"explanation": "e", "program": f"```\n{GOOD}```"})] * 2
    assert main(["vlm", "reward", *words, CAMS]) == 0
    assert main(["vlm", "reward", *words, CAMS, "flavour=text"]) == 0
    shown = [
        sum("inlineData" in part for part in body["contents"][0]["parts"])
        for body in server.requests
    ]
    assert shown == [2, 0]
    folder = study / "rewards/dep_front+seg_side"
    assert (folder / "image.txt").read_text() == (folder / "text.txt").read_text() == GOOD
    (row,) = lines_of(folder / "image.attempts.jsonl")
    assert row["accepted"]
    assert row["card"]["ok"]
    # The text-only reward is common to all cameras.
    assert main(["vlm", "reward", *words, "cams=[rgb_default]", "flavour=text"]) == 0
    assert len(server.requests) == 2


def test_an_accepted_program_is_not_replaced_unasked(study, words, server, capsys):
    first, second = (
        json.dumps({"explanation": "e", "program": f"reward = {value}"}) for value in (1, 2)
    )
    server.script[:] = [first, second]
    assert main(["vlm", "reward", *words, CAMS]) == 0
    assert main(["vlm", "reward", *words, CAMS]) == 2
    assert "overwrite=true" in capsys.readouterr().err
    folder = study / "rewards/dep_front+seg_side"
    assert (folder / "image.txt").read_text() == "reward = 1\n"
    assert main(["vlm", "reward", *words, CAMS, "overwrite=true"]) == 0
    assert (folder / "image.txt").read_text() == "reward = 2\n"
    assert (folder / "image.1.txt").read_text() == "reward = 1\n"


def test_a_program_refused_too_often_leaves_its_attempts(study, words, server, capsys):
    server.script[:] = [{"refusal": "PROHIBITED_CONTENT"}]
    assert main(["vlm", "reward", *words, CAMS]) == 2
    assert "refused to answer: PROHIBITED_CONTENT" in capsys.readouterr().err
    assert not (study / "rewards").exists()
    bad = json.dumps({"explanation": "e", "program": "import os"})
    server.script[:] = [bad] * 2
    assert main(["vlm", "reward", *words, CAMS, "attempts=2"]) == 2
    assert "import is not allowed" in capsys.readouterr().err
    folder = study / "rewards/dep_front+seg_side"
    rows = lines_of(folder / "image.attempts.jsonl")
    assert [row["accepted"] for row in rows] == [False, False]
    assert not (folder / "image.txt").exists()


def programs(*worths: int | str) -> list[str]:
    """Answers with such programs; a text is one as it is."""
    sources = [one if isinstance(one, str) else f"reward = {one}" for one in worths]
    return [json.dumps({"explanation": "e", "program": source}) for source in sources]


def test_several_samples_are_conversations_and_files_of_their_own(study, words, server):
    server.script[:] = programs(3, 4, 5)
    assert main(["vlm", "reward", *words, CAMS, "samples=3"]) == 0
    assert len(server.requests) == 3
    # Each sample is a conversation of its own.
    assert all(len(body["contents"]) == 1 for body in server.requests)
    folder = study / "rewards/dep_front+seg_side"
    for name, own in (("image.txt", 3), ("image_2.txt", 4), ("image_3.txt", 5)):
        assert (folder / name).read_text() == f"reward = {own}\n"
    assert (folder / "image_3.attempts.jsonl").exists()
    names = [line["conversation"] for line in lines_of(study / "transcript.jsonl")][-3:]
    own = "reward/dep_front+seg_side/image"
    assert names == [own, f"{own}/2", f"{own}/3"]
    # Asked again, all is there; without two of them, the record gives the same.
    assert main(["vlm", "reward", *words, CAMS, "samples=3"]) == 2
    before = contents(folder)
    (folder / "image_2.txt").unlink()
    (folder / "image_3.txt").unlink()
    assert main(["vlm", "reward", "size=16", CAMS, "samples=3"]) == 0
    assert contents(folder) == before
    assert len(server.requests) == 3


def test_the_sample_that_is_trained_on_is_chosen_and_named(study, words, server, monkeypatch):
    server.script[:] = programs(3, 4)
    assert main(["vlm", "reward", *words, CAMS, "samples=2"]) == 0
    (_, run), *_ = trained(monkeypatch, "reward.sample=2")
    text = (run.folder / "reward.txt").read_text()
    assert text.startswith("# From results/main/vlm/rewards/dep_front+seg_side/image_2.txt.")
    assert run.config()["reward"]["sample"] == 2
    with pytest.raises(ValueError, match=r"no image reward \(sample 3\) .* samples=3 vlm=gemini"):
        trained(monkeypatch, "reward.sample=3", "seed=1")
    with pytest.raises(ValueError, match=r"reward\.sample: 0 must be at least 1"):
        trained(monkeypatch, "reward.sample=0", "seed=2")


def test_a_sample_that_fails_does_not_take_the_others_with_it(study, words, server, capsys):
    server.script[:] = programs(3, "import os", 5)
    assert main(["vlm", "reward", *words, CAMS, "samples=3", "attempts=1"]) == 2
    assert "image/2: no usable answer in 1 attempts" in capsys.readouterr().err
    folder = study / "rewards/dep_front+seg_side"
    kept = {path.name for path in folder.glob("*.txt")}
    assert kept == {"image.txt", "image_3.txt"}


@pytest.mark.full
def test_programs_for_all_sets_are_one_command(study, words, server, capsys):
    """And a sweep over them finds each."""
    server.otherwise = lambda schema, prompt: programs(3)[0]
    assert main(["vlm", "reward", *words, "cams=all"]) == 0
    assert len(server.requests) == 14
    swept = yaml.safe_load((CONF / "experiment" / "table2.yaml").read_text())
    sets = re.findall(r"\[[^\]]*\]", swept["hydra"]["sweeper"]["params"]["cams"])
    assert len(sets) == 14
    for cams in sets:
        name = cams.strip("[]").replace(",", "+")
        assert (study / f"rewards/{name}/image.txt").read_text() == "reward = 3\n"
    for cams in (sets[0], sets[-1]):
        job = composing.compose([f"cams={cams}", "reward=vlm_img", "reward.recording=null"], "job")
        found = load_reward(job["reward"])(random_signals(1, seed=0))
        assert float(rewards.potential(found)[0]) == 3
    capsys.readouterr()
    (study / "rewards/rgb_default/image.txt").unlink()
    assert main(["vlm", "reward", *words, "cams=[rgb_default],[dep_front,seg_side]"]) == 0
    assert capsys.readouterr().out.count("is there already") == 1
    # What was removed is in the record.
    assert len(server.requests) == 14


def test_sets_can_be_listed_and_one_that_fails_is_named(study, words, server, capsys):
    server.script[:] = programs(3, "import os", 5)
    sets = "cams=[rgb_default],[dep_front,seg_side],[seg_side]"
    assert main(["vlm", "reward", *words, sets, "attempts=1"]) == 2
    error = capsys.readouterr().err
    assert "1 of 3 sets have no program: dep_front+seg_side" in error
    assert (study / "rewards/rgb_default/image.txt").read_text() == "reward = 3\n"
    assert (study / "rewards/seg_side/image.txt").read_text() == "reward = 5\n"
    assert main(["vlm", "reward", *words, "cams=[rgb_default],[rgb_top]"]) == 2
    assert "rgb_top" in capsys.readouterr().err
    assert len(server.requests) == 3


def trained_run(folder: Path, tmp: Path) -> Path:
    """A run's files: a program, two terms, a film."""
    folder.mkdir(parents=True)
    origin = str(tmp / "results/main/vlm/rewards/dep_front+seg_side/text.txt")
    reward = {"kind": "vlm_text", "program": {"text": GOOD, "origin": origin}}
    (folder / "config.yaml").write_text(yaml.safe_dump({"reward": reward}))
    rows = [f"{n},{1000 * n},{n},{n / 7},{n / 5},0.25,0.5" for n in range(1, 31)]
    head = "update,step,wall_time,return,term_near,success,threaded"
    (folder / "metrics.csv").write_text("\n".join([head, *rows]) + "\n")
    with imageio.get_writer(folder / "video.mp4", fps=10) as film:  # pyright: ignore
        for number in range(30):
            film.append_data(np.full((64, 96, 3), 8 * number, np.uint8))
    return folder


# imageio-ffmpeg leaves its pipes for the garbage collector to close.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_program_is_revised_after_a_training(study, words, server, tmp_path, capsys):
    run = trained_run(tmp_path / "run", tmp_path.resolve())
    first = json.dumps({"explanation": "so", "program": GOOD})
    better = json.dumps({"explanation": "more", "program": "reward = 9 if lifted else 0"})
    server.script[:] = [first]
    assert main(["vlm", "reward", CAMS, "flavour=text", *words]) == 0
    server.script[:] = [better]
    assert main(["vlm", "reward", CAMS, "flavour=text", f"revise={run}", *words]) == 0
    asked = json.dumps(server.requests[-1])
    assert "reward = 9 if grasped else 0" in asked
    assert "step, return, near, done" in asked
    assert "1000, 0.143, 0.2, 0.25" in asked
    assert "30000, 4.29, 6, 0.25" in asked
    assert "threaded" not in asked
    assert asked.count("image/png") == 6
    place = study / "rewards/dep_front+seg_side"
    assert "lifted" in (place / "text_2.txt").read_text()
    assert (place / "text.txt").read_text() == GOOD
    (origin,) = json.loads((place / "text_2.descent.json").read_text())["line"]
    assert origin["run"] == str(run)
    assert origin["program"].endswith("text.txt")
    # The next in line names both.
    config = yaml.safe_load((run / "config.yaml").read_text())
    config["reward"]["program"] = {"text": "reward = 3\n", "origin": str(place / "text_2.txt")}
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    (run / "video.mp4").unlink()
    # In a run's first buffers no episode may end.
    table = (run / "metrics.csv").read_text().splitlines()
    (run / "metrics.csv").write_text("\n".join([table[0], "1,1000,1,,,,", *table[2:]]) + "\n")
    server.script[:] = [first]
    assert main(["vlm", "reward", CAMS, "flavour=text", f"revise={run}", *words]) == 0
    asked = json.dumps(server.requests[-1])
    assert "There is no film" in asked
    assert "1000, -, -, -\\n4000, 0.571, 0.8, 0.25" in asked
    line = json.loads((place / "text_3.descent.json").read_text())["line"]
    assert [Path(one["program"]).name for one in line] == ["text.txt", "text_2.txt"]


def test_only_a_run_that_a_program_paid_is_revised(study, words, server, tmp_path, capsys):
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.yaml").write_text("reward: {kind: human}\n")
    for folder, said in ((run, "was trained on no program"), (tmp_path, "is no run")):
        assert main(["vlm", "reward", CAMS, "flavour=text", f"revise={folder}", *words]) == 2
        assert said in capsys.readouterr().err
    assert server.requests == []


def test_a_line_cut_off_is_reported_by_name(study, capsys):
    path = study / "transcript.jsonl"
    path.write_bytes(path.read_bytes() + b'{"sha2')
    assert main(["vlm", "question", "size=16"]) == 0
    assert f"{path}: line 9 is cut off" in capsys.readouterr().err


def test_any_openai_compatible_server_can_be_asked(study, server):
    # The questioning's pictures are there; another model needs a study of its own.
    other = Path("results/other/vlm")
    shutil.copytree(study / "images", other / "images")
    shutil.copy(study / "pictures.json", other)
    words = ["vlm=openai", "vlm.model=m", f"vlm.base_url={server.url}/v1", "vlm.key=null"]
    assert main(["vlm", "question", *words, "size=16", "study=other"]) == 0
    assert json.loads((other / "questions.json").read_text())["models"] == ["openai test-model-001"]
    assert server.requests[0]["max_completion_tokens"] == 16384


MISTAKES = [
    (["question", "size=16", "task=near"], "its task differs"),
    (["question", "size=17"], "its size differs"),
    (["rank", "size=16"], "no recorded request is this one"),
    (["rank", "lists=[[rgb_default,rgb_top]]"], "default, front, side"),
    (["rank", "samples=0"], "samples: 0"),
    (["question", "vlm.recording=none"], "nothing is recorded in none/transcript.jsonl"),
    (["question", "vlm.told=little"], "vlm.told: 'little' is unknown; choose from full, names"),
    (["question", "vlm.told=names"], "vlm.told: 'names' is for rankings and rewards"),
    (["reward", CAMS, "flavour=text", "vlm.told=nothing"], "nothing goes with flavour=image"),
    (["question", "size=16", "disturb=mild"], "disturb: a model is told that its pictures"),
    (["reward", CAMS, "size=16", "disturb=mild"], "choose disturb=none"),
    (["question", "study=../x"], "study: '../x'"),
    (["question", "shown=[rgb,xray]"], "'xray' is unknown; choose from"),
    (["question", "attempts=0"], "attempts: 0"),
    (["question", "vlm=bard"], "gemini"),
    (["question", "vlm=openai"], "vlm.model"),
    (["question", "vlm=gemini", "vlm.tries=many"], "vlm.tries"),
    (["question", "vlm=gemini", "vlm.key=NO_SUCH_VARIABLE"], "NO_SUCH_VARIABLE is not set"),
    (["question", "vlm=gemini", "vlm.model=other"], "choose another study="),
    (["reward"], "cams: name the cameras"),
    (["reward", CAMS, "flavour=sound"], "choose from text, image"),
    (["reward", CAMS, "samples=0"], "samples: 0 must be at least 1"),
]


def test_a_mistake_is_one_message_that_names_the_key(study, capsys, server):
    for arguments, said in MISTAKES:
        assert main(["vlm", *arguments]) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith(f"needlehoop vlm {arguments[0]}: ")
        assert said in error
    assert server.requests == []


def trained(monkeypatch, *overrides: str) -> list[tuple]:
    """What ``train.py`` would train; as far as the run's folder."""
    made: list[tuple] = []
    monkeypatch.setattr(page, "train", lambda job, run, *_: made.append((job, run)))
    # What the gates say of programs is tested beside them.
    monkeypatch.setattr(session, "objections", lambda *_: [])
    values = composing.compose(
        [CAMS, "reward=vlm_img", "reward.recording=null", *overrides], "config"
    )
    values.pop("hydra", None)
    page.start(values, [], "python train.py")
    return made


@pytest.mark.full
def test_training_asks_for_a_reward_that_is_not_recorded(words, server, monkeypatch):
    words[words.index("size=16")] = "asking.size=16"
    server.script[:] = [json.dumps({"program": GOOD, "explanation": "held"})]
    (_, run), *_ = trained(monkeypatch, *words)
    assert Path("results/main/vlm/rewards/dep_front+seg_side/image.txt").read_text() == GOOD
    assert (run.folder / "reward.txt").read_text().endswith(GOOD)
    # The second training finds it.
    before = len(server.requests)
    trained(monkeypatch, *words, "seed=1")
    assert len(server.requests) == before


def test_training_asks_nobody_unless_told_to(server, monkeypatch):
    with pytest.raises(ValueError, match="no image reward is recorded"):
        trained(monkeypatch)
    assert not server.requests
    assert not Path("results").exists()


def test_training_stops_where_no_program_is_accepted(words, server, monkeypatch):
    words[words.index("size=16")] = "asking.size=16"
    server.script[:] = [json.dumps({"program": "import os", "explanation": ""})] * 3
    with pytest.raises(RewardError, match="no program was written"):
        trained(monkeypatch, *words)
    assert not Path("results/main/dep_front+seg_side").exists()
