"""Reading a study: what is whole counts, what is not is named."""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from study_files import BUFFER, TASK, UPDATES, write_answers, write_run

import needlehoop
from needlehoop.envs.controllers import Outcome
from needlehoop.learning.evaluate import with_intervals
from needlehoop.runs.files import EVALUATION, EVALUATIONS, METRICS
from needlehoop.runs.run import Run
from needlehoop.study.data.answers import read_answers
from needlehoop.study.data.records import Place, Study, read_study
from needlehoop.study.stats import predictions
from needlehoop.study.stats.findings import study_findings
from needlehoop.study.stats.run import evaluations, final
from needlehoop.tasks.registry import find
from needlehoop.training.session import task_note


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "main"
    write_run(folder, "dep_front+seg_side", goal=8.0)
    write_run(folder, "rgb_default", goal=1.0, updates=40)
    return folder


HTML = b"cams: ['" + b"<b>" * 20 + b"']\nobs: {}\nalgo: {}\n"
HEAD = b"update,step,wall_time,return,success\n"


def left_out(found: Study) -> dict[str, str]:
    return {str(one.path): one.reason for one in found.left_out}


def torn(study: Path) -> Path:
    return study / "rgb_default" / "human" / "seed0"


def test_whole_runs_are_read_in_order(study):
    found = read_study(study)
    assert [run.place for run in found.runs] == [
        Place("dep_front+seg_side", "human", 0),
        Place("rgb_default", "human", 0),
    ]
    whole, short = found.runs
    assert (whole.finished, short.finished) == (True, False)
    assert whole.steps == whole.planned_steps == UPDATES * BUFFER
    assert short.steps == 40 * BUFFER
    assert whole.metrics is not None
    assert math.isnan(whole.metrics["return"][0])
    assert whole.command == "python train.py 'cams=[dep_front,seg_side]' seed=0"
    assert found.left_out == ()


def test_a_run_is_made_again_with_the_command_that_made_it(study):
    manifest = study / "rgb_default/human/seed0/manifest.json"
    for words, command in (
        (["train.py", "seed=0"], "python train.py seed=0"),
        (["needlehoop", "train", "cams=[a,b]"], "needlehoop train 'cams=[a,b]'"),
        ("train.py seed=0", None),
    ):
        manifest.write_text(json.dumps({**json.loads(manifest.read_text()), "command": words}))
        (run,) = (one for one in read_study(study).runs if one.place.cameras == "rgb_default")
        assert run.command == command


def test_what_a_real_run_writes_is_read(tmp_path):
    folder = tmp_path / "main" / "seg_side" / "sparse" / "seed3"
    values = {"cams": ["seg_side"], "obs": {"signals": False}, "algo": {"horizon": 128}}
    values |= {"seed": 3, "steps": 20_480, "num_envs": 80}
    run = Run.create(folder, values, "sparse", overwrite=False)
    true = torch.ones(4, dtype=torch.bool)
    points = torch.full((4,), 8.5)
    task = find("needle_hoop")
    run.note(task=task_note(task))
    facts = dict.fromkeys(reversed(task.columns), true) | {"cheat": ~true}
    outcome = Outcome(facts, points, points, torch.full((4,), 50))
    at = {"update": 1, "step": 10_240, "wall_time": 12.5}
    run.append(METRICS, {**at, "return": 1.25, "success": float("nan")})
    run.append(EVALUATIONS, {**at, **outcome.summary()})
    (record,) = read_study(tmp_path / "main").runs
    half = final(record)
    assert half is not None
    assert (half.value, half.success, half.cheat, half.episodes) == (8.5, 1.0, 0.0, 4)
    assert not half.finished
    run.write(EVALUATION, json.dumps({"steps_trained": 20_480, **with_intervals(task, outcome)}))
    run.note(finished=True)
    (record,) = (found := read_study(tmp_path / "main")).runs
    whole = final(record)
    assert whole is not None
    assert (whole.value, whole.finished) == (8.5, True)
    assert evaluations(record) == [(10_240, 1.0), (20_480, 1.0)]
    assert record.manifest["versions"]["torch"] == torch.__version__
    assert found.left_out == ()


def test_the_state_counts_as_something_seen(tmp_path):
    values = {"cams": [], "obs": {"signals": True}, "algo": {"horizon": 128}}
    values |= {"seed": 0, "steps": 20_480, "num_envs": 80}
    folder = tmp_path / "main" / "signals" / "human" / "seed0"
    Run.create(folder, values, "", overwrite=False)
    assert read_study(tmp_path / "main").runs[0].place.cameras == "signals"


BAD_FILES = (
    ("config.yaml", b"", "no run: its config.yaml is empty"),
    ("config.yaml", b"cams: [", "no run: its config.yaml is no YAML"),
    ("config.yaml", b"- 1\n", "no run: its config.yaml holds no keys"),
    ("config.yaml", b"cams: 3\n", "no run: its config.yaml has no usable cams"),
    ("config.yaml", b"\xff\xfe\x00", "no run: its config.yaml is no text"),
    ("metrics.csv", b"", "is empty"),
    ("metrics.csv", b"a,b\n1,2\n", "is no table of a run: it has no column update, step"),
    ("metrics.csv", b"\x89PNG\r\n\x1a\n\xff", "is no text"),
    ("metrics.csv", b"update,step,wall_time,return,success\n", "is no table of numbers"),
    ("metrics.csv", b"update,step,wall_time,return,success\n1,2,x,1,1\n", "is no table of numbers"),
    ("metrics.csv", HEAD + b"1,2,3,1,1\n2,3\n", "a row is not whole"),
    ("metrics.csv", HEAD + b"1,,3,1,1\n", "has step that is not between 0"),
    ("evaluations.csv", b"update,step,wall_time\n1,2,3\n", "it has no column episodes"),
    ("evaluation.json", b'{"return": 8.1, "succ', "is no JSON, or cut off"),
    ("evaluation.json", b"[]", "holds no keys"),
    ("evaluation.json", b'{"return": NaN}', "has NaN, which is no JSON"),
    ("evaluation.json", b'{"return": 8.1}', "has no usable episodes, success"),
    ("config.yaml", HTML, "has no usable cams.0"),
    ("manifest.json", b"", "is empty"),
    ("manifest.json", b"{}", "says nothing of the task: its phases and cheats are not known"),
    *(
        ("manifest.json", json.dumps({"task": task}).encode(), "has no usable task")
        for task in (
            *("needle_hoop", {}, TASK | {"name": "../secret"}, TASK | {"goal": "unknown"}),
            *(TASK | {"columns": 3}, TASK | {"columns": ["threaded"]}),
            *(TASK | {"phases": [["lift"]]}, TASK | {"phases": [["lift", "raised"]]}),
            *(TASK | {"phases": ["go"]}, TASK | {"columns": [*TASK["columns"], "<b>"]}),
        )
    ),
    (
        "evaluations.csv",
        b"update,step,wall_time,episodes,threaded,grasped,lifted,diverged,success,cheat,return\n"
        b"1,9,3,0,0,0,0,0,0,0,0\n",
        "has episodes that is not between 1 and",
    ),
    ("metrics.csv", HEAD + b"1,2,3,1e308,1\n", "has return that is not between -1e+09 and"),
    ("metrics.csv", HEAD + b"1,2,3,2e9,1\n", "has return that is not between -1e+09 and"),
    ("reward.txt", b"", "is empty"),
    ("reward.txt", b"\x80", "is no text"),
    ("video.mp4", b"", "is no film, or cut off"),
    ("video.mp4", b"\0\0\0\x08ftyp\0\0\0\x08mdat", "is no film, or cut off"),
)


def test_a_bad_file_is_named_and_the_rest_counts(study):
    for name, content, reason in BAD_FILES:
        path = torn(study) / name
        before = path.read_bytes() if path.exists() else None
        path.write_bytes(content)
        found = read_study(study)
        no_run = name == "config.yaml"
        where = str((path.parent if no_run else path).relative_to(study))
        assert list(left_out(found)) == [where], (name, content)
        assert reason in left_out(found)[where]
        assert len(found.runs) == (1 if no_run else 2)
        # Whatever was in it, the study can still be summed up.
        assert study_findings(study).results[0].cameras == "dep_front+seg_side"
        path.unlink() if before is None else path.write_bytes(before)


def test_a_torn_row_is_left_out_and_named(study):
    path = torn(study) / "metrics.csv"
    path.write_text(path.read_text()[:-5])
    found = read_study(study)
    assert [one.reason for one in found.left_out] == ["last row left out: torn off"]
    metrics = found.runs[1].metrics
    assert metrics is not None
    assert list(metrics["update"]) == [*range(1, 40)]


def test_folders_that_are_no_runs_are_named(study):
    (study / "rgb_default" / "human" / "seed7").mkdir()
    copied = write_run(study, "seg_side", seed=1).rename(study / "seg_side" / "human" / "seed2")
    write_run(study / "again", "rgb_default")
    write_run(study, "dep_side").rename(study / "dep_side" / "best")
    found = read_study(study)
    assert len(found.runs) == 2
    reasons = left_out(found)
    assert "config.yaml is missing" in reasons["rgb_default/human/seed7"]
    assert reasons[str(copied.relative_to(study))] == "its config has seed 1"
    # Names are read in order, so the copy under `again` comes first.
    assert "is rgb_default/human/seed0, as is" in reasons["rgb_default/human/seed0"]
    assert reasons["dep_side/best"] == "holds a run but is not called seed<k>"
    assert len(reasons) == 4


def test_a_whole_film_is_kept(study):
    whole = b"\0\0\0\x08ftyp\0\0\0\x01mdat\0\0\0\0\0\0\0\x14abcd\0\0\0\x08moov"
    (torn(study) / "video.mp4").write_bytes(whole)
    found = read_study(study)
    assert found.left_out == ()
    assert [run.video and run.video.name for run in found.runs] == [None, "video.mp4"]


def test_a_run_without_an_evaluation_has_no_final_value(study):
    (torn(study) / "evaluations.csv").unlink()
    found = study_findings(study)
    assert [result.cameras for result in found.results] == ["dep_front+seg_side"]
    assert [str(one.path) for one in found.left_out] == ["rgb_default/human/seed0"]


def test_an_unfinished_runs_value_is_the_mean_of_its_last_evaluations(study):
    record = read_study(study).runs[1]
    path = record.folder / "evaluations.csv"
    header, *_ = path.read_text().splitlines()
    rows = [dict.fromkeys(header.split(","), 0.0) for _ in range(4)]
    for row, update, value in zip(rows, (34, 37, 38, 40), (9.0, 1.0, 2.0, 4.0), strict=True):
        row |= {"update": update, "step": update * BUFFER, "return": value, "episodes": 10}
    rows[-1]["episodes"] = 30
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    found = final(read_study(study).runs[1])
    assert found is not None
    assert found.value == pytest.approx((1 * 10 + 2 * 10 + 4 * 30) / 50)
    assert (found.episodes, found.finished) == (50, False)
    # An evaluation from earlier on does not stand for the run; a later one does.
    early = {"episodes": 100, "return": 5.0, "success": 0.5, "cheat": 0.0, "diverged": 0.0}
    early |= {"grasped": 1.0, "lifted": 0.5, "threaded": 0.5}
    for steps, value in ((10 * BUFFER, found.value), (40 * BUFFER, 5.0)):
        text = json.dumps({**early, "steps_trained": steps})
        (record.folder / EVALUATION).write_text(text)
        now = final(read_study(study).runs[1])
        assert now is not None
        assert (now.value, now.finished) == (pytest.approx(value), False)


def test_a_finished_runs_value_is_its_last_evaluation_whenever_it_was_made(study):
    path = study / "dep_front+seg_side" / "human" / "seed0" / EVALUATION
    whole = json.loads(path.read_text())
    del whole["steps_trained"]
    path.write_text(json.dumps({**whole, "return": 3.5}))
    found = final(read_study(study).runs[0])
    assert found is not None
    assert (found.value, found.finished) == (3.5, True)
    assert evaluations(read_study(study).runs[0])[-1][0] == UPDATES * BUFFER


def test_only_true_is_finished(study):
    path = study / "dep_front+seg_side" / "human" / "seed0" / "manifest.json"
    for odd in (1, "yes", None):
        path.write_text(json.dumps({**json.loads(path.read_text()), "finished": odd}))
        assert not read_study(study).runs[0].finished


def test_no_such_study(tmp_path):
    with pytest.raises(ValueError, match="no such folder"):
        read_study(tmp_path / "nowhere")


def test_answers_are_read(tmp_path):
    write_answers(tmp_path)
    found, problems = read_answers(tmp_path)
    assert problems == []
    assert found is not None
    assert found.source == "test-model"
    assert [a.answer for a in found.questions][1:5] == ["front", "dep", "side", "seg"]
    assert found.questions[-2].question == "Best rendering to see that the needle is lifted"
    assert found.rankings[0].reasons["rgb_default"] == "Because of rgb_default."
    assert list(found.rankings[2].places.values()) == [1, 2, 3, 4, 5, 6]


def test_a_fact_without_words_goes_by_its_name(tmp_path):
    write_answers(tmp_path)
    path = tmp_path / "vlm" / "questions.json"
    told = json.loads(path.read_text())
    for asked, said in (({}, "it is lifted"), ({"asked": {"lifted": "it is up"}}, "it is up")):
        path.write_text(json.dumps({"answers": told["answers"], "models": []} | asked))
        found, _ = read_answers(tmp_path)
        assert found is not None
        assert found.questions[-2].question == f"Best rendering to see that {said}"
    path.write_text(json.dumps(told | {"asked": {"lifted": 3}}))
    _, problems = read_answers(tmp_path)
    assert [problem.reason for problem in problems] == ["has no usable asked.lifted"]


def test_repeated_rankings_give_mean_places(tmp_path):
    write_answers(tmp_path)
    path = tmp_path / "vlm" / "rankings.json"
    found = json.loads(path.read_text())
    places = [{"name": name, "reason": name} for name in "abc"]
    found["lists"] = [{"combinations": list("abc"), "rankings": [places, places[::-1], places]}]
    path.write_text(json.dumps(found))
    answers, _ = read_answers(tmp_path)
    assert answers is not None
    assert answers.rankings[0].places == pytest.approx({"a": 5 / 3, "b": 2.0, "c": 7 / 3})


def test_stated_probabilities_are_of_neighbours_in_each_order(tmp_path):
    write_answers(tmp_path)
    path = tmp_path / "vlm" / "rankings.json"
    found = json.loads(path.read_text())
    places = [{"name": name, "reason": name} for name in "abc"]
    entry = {"rankings": [places, places[::-1]], "sure": [[0.9, 0.5], [0.6, 1]]}
    path.write_text(json.dumps({**found, "lists": [entry]}))
    answers, _ = read_answers(tmp_path)
    assert answers is not None
    pairs = (("a", "b", 0.9), ("b", "c", 0.5), ("c", "b", 0.6), ("b", "a", 1.0))
    assert answers.rankings[0].sure == pairs
    one = predictions.said("m", answers)
    # a > b holds, b and c are equal; the last, sure of b > a, is as wrong as can be.
    measured = {"a": 2.0, "b": 1.0, "c": 1.0}
    assert one.brier("abc", measured) == pytest.approx((0.1**2 + 0 + 0.1**2 + 1) / 4)
    assert one.brier("abd", measured) is None
    for odd in ([[0.9, 2], []], [[True], []], [3, 4], [[]]):
        path.write_text(json.dumps({**found, "lists": [{**entry, "sure": odd}]}))
        _, problems = read_answers(tmp_path)
        assert "sure" in problems[0].reason


def test_the_best_placements_of_one_and_two_cameras_are_answers(tmp_path):
    write_answers(tmp_path)
    path = tmp_path / "vlm" / "questions.json"
    told = json.loads(path.read_text())
    places = [{"name": name, "reason": "r"} for name in ("rgb_side", "rgb_front")]
    told["answers"] |= {"placements": {"1": {"places": places, "sure": [0.6]}}, "layouts_sure": []}
    path.write_text(json.dumps(told))
    found, problems = read_answers(tmp_path)
    assert problems == []
    assert found is not None
    last = found.questions[-1]
    assert (last.question, last.answer) == ("Best placement of one camera", "rgb_side")


def test_bad_answers_are_named(tmp_path):
    write_answers(tmp_path)
    for content, reason in (
        ("", "is empty"),
        ('{"lists"', "is no JSON"),
        ('{"lists": [], "models": 3}', "has no usable models"),
        ('{"lists": [{"rankings": [[]]}], "models": []}', "differ in what they rank"),
        ('{"lists": [{"rankings": [[{"name": "a", "reason": 1}]]}]}', "rankings.0.0.reason"),
    ):
        (tmp_path / "vlm" / "rankings.json").write_text(content)
        found, problems = read_answers(tmp_path)
        assert found is not None
        assert found.questions
        assert [str(problem.path) for problem in problems] == ["vlm/rankings.json"]
        assert reason in problems[0].reason


def test_the_study_package_imports_no_simulator_and_no_torch():
    home = Path(needlehoop.__file__).parent
    folder = home / "study"
    files = (path.relative_to(home.parent).with_suffix("") for path in folder.rglob("*.py"))
    modules = [".".join(path.parts) for path in files]
    assert len(modules) > 10
    script = (
        "import sys, importlib\n"
        "class Wall:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('torch', 'mujoco', 'dm_control', 'hydra'):\n"
        "            raise ImportError(f'{name} is not for the study')\n"
        "sys.meta_path.insert(0, Wall())\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "from needlehoop.cli import main as cli\n"
        "sys.exit(cli.main(['status', sys.argv[1]]))\n"
    )
    command = [sys.executable, "-W", "error", "-c", script, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_studys_rooms_import_one_way():
    home = Path(needlehoop.__file__).parent / "study"
    rooms = ("data", "stats", "render", "report")
    for number, room in enumerate(rooms):
        for path in (home / room).glob("*.py"):
            above = [
                one for one in rooms[number + 1 :] if f"needlehoop.study.{one}" in path.read_text()
            ]
            assert not above, path
