"""``needlehoop vlm question``, ``rank`` and ``reward``, as typed, and their replay."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
import yaml
from PIL import Image
from tiny_runs import contents
from vlm_server import KEY, Server, by_schema

from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.rewards import RewardError
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data import paper
from needlehoop.training import loop as page
from needlehoop.training import session
from needlehoop.vlm.conversation import Verdict
from needlehoop.vlm.writing import ProgramRules

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
        # An answer in the wrong form, then as asked.
        running.otherwise, running.script = by_schema, ["no JSON"]
        words = ["vlm=gemini", f"vlm.base_url={running.url}", "size=16"]
        assert main(["vlm", "question", *words, f"results={results}"]) == 0
    return results


@pytest.fixture
def study(studied: Path, tmp_path: Path) -> Path:
    shutil.copytree(studied, tmp_path / "results")
    return Path("results/main/vlm")


def lines_of(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def conversations(study: Path) -> list[str]:
    """Names, of what came after the questioning."""
    return [line["conversation"] for line in lines_of(study / "transcript.jsonl")][8:]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def programs(*worths: int | str) -> list[str]:
    """Answers with such programs; a text is one as it is."""
    sources = [worth if isinstance(worth, str) else f"reward = {worth}" for worth in worths]
    return [json.dumps({"explanation": "e", "program": source}) for source in sources]


def shown(server: Server) -> list[int]:
    """Pictures in the first message of each request."""
    return [sum("inlineData" in p for p in b["contents"][0]["parts"]) for b in server.requests]


def test_question_leaves_answers_a_transcript_and_pictures(study):
    result = json.loads((study / "questions.json").read_text())
    assert list(result["answers"]) == [
        *("subtasks", "suits", "goal", "lifted", "layouts", "layouts_sure", "placements")
    ]
    questions = {row["question"]: row for row in rows_of(study / "questions.csv")}
    assert {row["question"] for row in rows_of(RECORDINGS / "paper/table_1.csv")} <= set(questions)
    best, meant = questions["Best view for subtask 2"], result["answers"]["suits"]["second"]
    assert (best["answer"], best["reason"]) == (meant["view"], meant["view_reason"])
    assert result["models"] == ["gemini gemini-test-001"]
    assert (result["totals"]["prompts"], result["totals"]["invalid_answers"]) == (8, 1)
    pictures = json.loads((study / "pictures.json").read_text())["pictures"]
    assert list(pictures) == ["start", "grasped", "lifted", "goal", "seen"]
    assert {len(shown) for shown in pictures.values()} == {12}
    # The agent's 64 pixels are more than these; none of them is left out. Two stages, and the
    # colours and the depth of ``dep``, stand side by side.
    for state, camera, size in (
        ("start", "rgb_front", (16, 16)),
        ("start", "dep_front", (33, 16)),
        ("seen", "rgb_front", (129, 64)),
        ("seen", "dep_front", (259, 64)),
    ):
        with Image.open(study / "images" / f"{pictures[state][camera]}.png") as image:
            assert image.size == size
    # Things moved, and a depth picture is no colour picture.
    assert pictures["start"]["rgb_front"] != pictures["goal"]["rgb_front"]
    assert pictures["start"]["rgb_front"] != pictures["start"]["dep_front"]


def test_everything_asked_again_offline_gives_the_same_files(study, words, server, capsys):
    commands = [["question"], ["rank", "samples=2"]]
    commands += [["reward", CAMS, f"flavour={flavour}"] for flavour in ("text", "image")]
    for command in commands[1:]:
        if command[0] == "reward":
            server.script = programs("import os") if command[-1] == "flavour=text" else []
        assert main(["vlm", *command, *words]) == 0
    output, count = capsys.readouterr().out, len(server.requests)
    for command in commands:
        assert main(["vlm", *command, "size=16", "study=again", f"vlm.recording={study}"]) == 0
    assert len(server.requests) == count
    # Of the last command, in which nothing was refused, and of all that was asked.
    assert "this:       1 prompts, 115 tokens (100 in, 15 out), 0 invalid answers" in output
    assert f"transcript: {8 + 3 + 7 + 3 + 3} prompts" in output
    assert "2 invalid answers\nthe paper:  25 prompts, 14137 tokens" in output
    before, after = contents(study), contents(Path("results/again/vlm"))
    assert len(after) == 6 + 4
    assert {name: before[name] for name in after} == after


def test_samples_are_fresh_conversations_whose_agreement_is_in_tables(study, words, server):
    def reversed_from_the_second(schema, prompt):
        answer = json.loads(by_schema(schema))
        if "places" in answer and len(server.requests) > 4:
            answer["places"].reverse()
        return json.dumps(answer)

    # One that is no permutation goes back.
    server.script = ['{"places": [{"name": "rgb_default", "reason": "r"}]}']
    server.otherwise = reversed_from_the_second
    lists = "lists=[[rgb_default,dep_front+seg_side,seg_side],[rgb_front,rgb_side]]"
    assert main(["vlm", "rank", *words, lists, "samples=2"]) == 0
    correction = server.requests[1]["contents"][-1]["parts"][0]["text"]
    assert "missing: dep_front+seg_side" in correction
    # Two lists, then seven questions (none goes wrong this time) and two lists.
    assert len(server.requests) == 3 + 7 + 2
    assert len(server.requests[3]["contents"]) == 1
    assert conversations(study) == ["rank"] * 3 + ["rank/2"] * 9
    ranked = rows_of(study / "rankings.csv")
    assert len(ranked) == 2 * (3 + 2)
    assert ranked[0]["sure"] == "0.75"
    last = {"list": "1", "sample": "1", "place": "3", "cameras": "seg_side", "sure": ""}
    assert ranked[2] == {**last, "reason": "because of seg_side"}
    agreed = {"list": "2", "samples": "2", "tau_b": "-1.0", "same_top": "0.5"}
    assert rows_of(study / "agreement.csv")[1] == agreed
    costs = {row["conversation"]: row["prompts"] for row in rows_of(study / "totals.csv")}
    assert costs == {"question": "8", "rank": "3", "rank/2": "9", "all": "20"}


def test_lists_are_ranked_afresh_each_in_a_conversation_of_its_own(study, words, server):
    lists = "lists=[[rgb_default,dep_front+seg_side],[rgb_front,rgb_side]]"
    assert main(["vlm", "rank", *words, "afresh=true", lists, "samples=2"]) == 0
    assert [len(body["contents"]) for body in server.requests] == [1] * 4
    # The cameras of a list, at four stages and as the agent sees them.
    assert shown(server) == [3 * 5, 2 * 5] * 2
    assert conversations(study) == [f"rank_afresh/{name}" for name in ("1", "2", "1/2", "2/2")]
    rankings = json.loads((study / "rankings_afresh.json").read_text())
    assert [entry["sure"] for entry in rankings["lists"]] == [[[0.75]] * 2] * 2
    assert not (study / "rankings.json").exists()


def test_overwrite_asks_anew_and_keeps_what_there_was(study, words, server):
    assert main(["vlm", "rank", *words]) == 0
    before = contents(study)
    server.requests.clear()
    assert main(["vlm", "question", *words]) == 0
    assert server.requests == []
    assert contents(study) == before
    assert main(["vlm", "question", *words, "overwrite=true"]) == 0
    after = contents(study)
    for kept in ("transcript.jsonl", "questions.json", "rankings.json"):
        assert after[kept.replace(".", ".1.")] == before[kept]
    assert "rankings.json" not in after
    assert after["transcript.jsonl"].count(b"\n") == len(server.requests) == 7


def test_reward_shows_the_cameras_pictures_or_none(study, words, server, capsys):
    server.script = programs(f"```\n{GOOD}```", GOOD)
    assert main(["vlm", "reward", *words, CAMS]) == 0
    assert main(["vlm", "reward", *words, CAMS]) == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert main(["vlm", "reward", *words, CAMS, "flavour=text"]) == 0
    assert shown(server) == [2, 0]
    folder = study / "rewards/dep_front+seg_side"
    assert (folder / "image.txt").read_text() == (folder / "text.txt").read_text() == GOOD
    (row,) = lines_of(folder / "image.attempts.jsonl")
    assert (row["accepted"], row["card"]["ok"]) == (True, True)
    # The text-only reward is common to all cameras.
    assert main(["vlm", "reward", *words, "cams=[rgb_default]", "flavour=text"]) == 0
    assert len(server.requests) == 2


def test_several_samples_are_conversations_and_files_of_their_own(study, words, server, capsys):
    server.script = programs(3, "import os", 5, 4)
    samples = ["vlm", "reward", *words, CAMS, "samples=3"]
    # One that fails does not take the others with it.
    assert main([*samples, "attempts=1"]) == 2
    error = capsys.readouterr().err
    assert "image/2: no usable answer in 1 attempts; the last: the program was refused" in error
    folder = study / "rewards/dep_front+seg_side"
    (row,) = lines_of(folder / "image_2.attempts.jsonl")
    assert (row["accepted"], row["program"]) == (False, "import os\n")
    # More attempts go on from there; the others are in the record.
    assert main([*samples, "attempts=2"]) == 0
    for name, worth in (("image.txt", 3), ("image_2.txt", 4), ("image_3.txt", 5)):
        assert (folder / name).read_text() == f"reward = {worth}\n"
    prefix = "reward/dep_front+seg_side/image"
    assert conversations(study) == [prefix, f"{prefix}/2", f"{prefix}/3", f"{prefix}/2"]
    assert len(server.requests) == 4


def test_sets_can_be_listed_and_one_that_fails_is_named(study, words, server, capsys, monkeypatch):
    server.script = programs(3, "import os", 5)
    sets = "cams=[rgb_default],[dep_front,seg_side],[seg_side]"
    assert main(["vlm", "reward", *words, sets, "attempts=1"]) == 2
    assert "1 of 3 sets have no program: dep_front+seg_side" in capsys.readouterr().err
    assert (study / "rewards/rgb_default/image.txt").read_text() == "reward = 3\n"
    assert (study / "rewards/seg_side/image.txt").read_text() == "reward = 5\n"
    server.script = programs(4)
    # The paper's, of which one is there.
    monkeypatch.setattr(paper, "measured", lambda: ("rgb_default", "dep_front+seg_side"))
    assert main(["vlm", "reward", *words, "cams=all"]) == 0
    assert capsys.readouterr().out.count("is there already") == 1
    assert (study / "rewards/dep_front+seg_side/image.txt").read_text() == "reward = 4\n"


def trained_run(folder: Path, origin: Path) -> Path:
    """A run's files: a program, two terms, a film."""
    folder.mkdir(parents=True)
    reward = {"kind": "vlm_text", "program": {"text": GOOD, "origin": str(origin)}}
    (folder / "config.yaml").write_text(yaml.safe_dump({"reward": reward}))
    rows = [f"{n},{1000 * n},{n},{n / 7},{n / 5},0.25,0.5" for n in range(1, 31)]
    # In a run's first buffers no episode may end.
    rows[0] = "1,1000,1,,,,"
    head = "update,step,wall_time,return,term_near,success,threaded"
    (folder / "metrics.csv").write_text("\n".join([head, *rows]) + "\n")
    with imageio.get_writer(folder / "video.mp4", fps=10) as film:  # pyright: ignore
        for number in range(30):
            film.append_data(np.full((64, 96, 3), 8 * number, np.uint8))
    return folder


# imageio-ffmpeg leaves its pipes for the garbage collector to close.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_program_is_revised_after_a_training(study, words, server, tmp_path):
    place = study / "rewards/dep_front+seg_side"
    run = trained_run(tmp_path / "run", place / "text.txt")
    text = ["vlm", "reward", CAMS, "flavour=text", *words]
    server.script = programs(GOOD, "reward = 9 if lifted else 0", 3)
    assert main(text) == 0
    assert main([*text, f"revise={run}"]) == 0
    request = json.dumps(server.requests[-1])
    assert "reward = 9 if grasped else 0" in request
    assert "step, return, near, done\\n1000, -, -, -\\n4000, 0.571, 0.8, 0.25" in request
    assert "30000, 4.29, 6, 0.25" in request
    assert "threaded" not in request
    assert request.count("image/png") == 6
    assert "lifted" in (place / "text_2.txt").read_text()
    assert (place / "text.txt").read_text() == GOOD
    (run / "video.mp4").unlink()
    assert main([*text, f"revise={run}"]) == 0
    assert "There is no film" in json.dumps(server.requests[-1])
    assert (place / "text_3.txt").read_text() == "reward = 3\n"


MISTAKES = [
    (["question", "size=17"], "its size differs"),
    (["rank", "size=16"], "no recorded request is this one"),
    (["question", "vlm.recording=none"], "nothing is recorded in none/transcript.jsonl"),
    (
        ["question", "vlm.prompt_detail=names"],
        "vlm.prompt_detail: 'names' is for rankings and rewards",
    ),
    (["reward", CAMS, "size=16", "disturb=mild"], "disturb: a model is told that its pictures"),
    (["question", "vlm=gemini", "vlm.model=other"], "choose another study="),
    (["reward"], "cams: name the cameras"),
]


def test_a_mistake_is_one_message_that_names_the_key(study, capsys, server):
    for arguments, message in MISTAKES:
        assert main(["vlm", *arguments]) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith(f"needlehoop vlm {arguments[0]}: ")
        assert message in error
    assert server.requests == []


def trained(monkeypatch, *overrides: str) -> list[tuple]:
    """What ``train.py`` would train; as far as the run's folder."""
    made: list[tuple] = []
    monkeypatch.setattr(page, "train", lambda job, run, *_: made.append((job, run)))
    # What the gates say of programs is tested beside them.
    monkeypatch.setattr(session, "objections", lambda *_: [])
    values = composing.compose(
        [CAMS, "reward=vlm_img", "reward.recording=null", "asking.size=16", *overrides], "config"
    )
    values.pop("hydra", None)
    page.start(values, [], "python train.py")
    return made


def test_training_asks_for_a_reward_that_is_not_recorded(words, server, monkeypatch):
    # Nobody is asked unasked.
    with pytest.raises(ValueError, match="no image reward is recorded"):
        trained(monkeypatch)
    words.remove("size=16")
    server.script = programs(GOOD)
    (_, run), *_ = trained(monkeypatch, *words)
    assert Path("results/main/vlm/rewards/dep_front+seg_side/image.txt").read_text() == GOOD
    assert (run.folder / "reward.txt").read_text().endswith(GOOD)
    assert run.config()["reward"]["program"]["text"] == GOOD
    # The second training finds it.
    trained(monkeypatch, *words, "seed=1")
    assert len(server.requests) == 1
    server.script = programs(*["import os"] * 3)
    with pytest.raises(RewardError, match="no program was written"):
        trained(monkeypatch, *words, "reward.sample=2")
