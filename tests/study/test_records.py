"""Reading a study: what is whole counts, what is not is named."""

import json
import math
from pathlib import Path

import pytest
from study_files import BUFFER, UPDATES, change, write_answers, write_run

import needlehoop
from needlehoop.study.data.answers import read_answers
from needlehoop.study.data.records import Place, read_run, read_study
from needlehoop.study.stats.run import BEST, RETURN, TRAINING, evaluations, final, steps_to_success


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "main"
    write_run(folder, "dep_front+seg_side", goal=8.0)
    write_run(folder, "rgb_default", goal=1.0, updates=40)
    return folder


def test_whole_runs_are_read_in_order(study):
    contents = read_study(study)
    places = [Place(cameras, "human", 0) for cameras in ("dep_front+seg_side", "rgb_default")]
    assert [run.place for run in contents.runs] == places
    whole, short = contents.runs
    assert (whole.finished, short.finished) == (True, False)
    assert whole.steps == whole.planned_steps == UPDATES * BUFFER
    assert short.steps == 40 * BUFFER
    assert whole.metrics is not None
    assert math.isnan(whole.metrics["return"][0])
    assert whole.command == "python train.py 'cams=[dep_front,seg_side]' seed=0"
    assert contents.left_out == ()


def test_what_a_real_run_writes_is_read(tiny_run):
    (record,) = read_study(tiny_run.parents[2]).runs
    assert record.place == Place("signals", "sparse", 0)
    end, written = final(record), json.loads((tiny_run / "evaluation.json").read_text())
    assert end is not None
    assert (end.finished, end.episodes) == (True, written["episodes"])
    assert end.measures[RETURN] == written["return"]
    on_the_way, last = evaluations(record)
    assert (on_the_way[0], last) == (16, (24, written["success"]))
    assert end.measures[BEST] == max(on_the_way[1], last[1])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("config.yaml", "seed: 0", "config.yaml: has no cams"),
        ("metrics.csv", "update,return\n1,2\n", "metrics.csv: has no steps that rise"),
        ("config.yaml", "another run's", "is dep_front+seg_side/human/seed0, as is"),
    ],
)
def test_a_run_that_cannot_be_read_is_named_and_left_out(study, name, text, message):
    run = study / "rgb_default" / "human" / "seed0"
    if text == "another run's":
        text = (study / "dep_front+seg_side/human/seed0/config.yaml").read_text()
    (run / name).write_text(text)
    contents = read_study(study)
    assert [record.place.cameras for record in contents.runs] == ["dep_front+seg_side"]
    (reason,) = contents.left_out
    assert reason.startswith("rgb_default/human/seed0: ")
    assert message in reason
    if "as is" not in message:
        with pytest.raises(ValueError, match=r"seed0: \w+\.(yaml|json|csv)"):
            read_run(run)


def test_a_row_that_was_torn_off_does_not_count(study):
    run = study / "rgb_default" / "human" / "seed0"
    with (run / "metrics.csv").open("a") as file:
        file.write("41,419840,656.0,640.0,60,1.0")
    (record,) = read_run(run).runs
    assert record.steps == 40 * BUFFER


def test_the_value_of_an_unfinished_run_is_the_mean_of_its_last_evaluations(study):
    run = study / "rgb_default" / "human" / "seed0"
    (run / "evaluations.csv").write_text(
        "update,step,wall_time,episodes,return,success,cheat,grasped,lifted,threaded,diverged\n"
        "1,100,1,20,1,0.1,0,0,0,0,0\n19,1900,1,20,2,0.2,0,0,0,0,0\n20,2000,1,60,4,0.6,0,0,0,0,0\n"
    )
    end = final(read_run(run).runs[0])
    assert end is not None
    assert (end.measures[RETURN], end.measures["success"]) == (
        pytest.approx(3.5),
        pytest.approx(0.5),
    )
    assert (end.episodes, end.finished, TRAINING in end.measures) == (80, False, False)
    # An evaluation that is older than these does not count, one that is newer does.
    evaluation = json.loads((study / "dep_front+seg_side/human/seed0/evaluation.json").read_text())
    for steps, episodes in ((1500, 80), (2500, 100)):
        (run / "evaluation.json").write_text(json.dumps(evaluation | {"steps_trained": steps}))
        end = final(read_run(run).runs[0])
        assert end is not None
        assert end.episodes == episodes


def test_the_return_over_training_is_the_mean_of_all_buffers(study):
    (run,) = read_run(study / "dep_front+seg_side/human/seed0").runs
    end = final(run)
    assert end is not None
    assert run.metrics is not None
    assert end.measures[TRAINING] == pytest.approx(run.metrics["return"][1:].mean())


def test_time_to_a_share_is_the_first_buffer_that_holds_it(study):
    run = study / "rgb_default" / "human" / "seed0"
    # One lucky buffer is not enough; five in which half succeed are.
    rates = [0.0, 1.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.6, 0.6, 0.5, 0.9]
    lines = [f"{i},{i * BUFFER},{i},1.0,{rate}" for i, rate in enumerate(rates, start=1)]
    text = "\n".join(["update,step,wall_time,return,success", *lines, ""])
    (run / "metrics.csv").write_text(text)
    (record,) = read_run(run).runs
    assert steps_to_success(record, 0.5) == 10 * BUFFER
    assert steps_to_success(record, 0.95) is None


def test_answers_become_the_rows_of_table_1(tmp_path):
    write_answers(tmp_path)
    answers = read_answers(tmp_path / "vlm")
    assert answers is not None
    assert answers.source == "test-model"
    rows = {row.question: row.answer for row in answers.questions}
    assert rows["Best view for subtask 2"] == "side"
    assert rows["Best view to see that the needle is lifted"] == "front"
    assert rows["Best combination of views"] == "front and side"
    assert read_answers(tmp_path) is None


def test_repeated_rankings_have_mean_places_and_stated_probabilities(tmp_path):
    write_answers(tmp_path)
    orders = [[{"name": name, "reason": ""} for name in order] for order in ("ab", "ba", "ab")]
    change(
        tmp_path / "vlm" / "rankings.json",
        lists=[{"rankings": orders, "sure": [[0.9], [0.6], [0.8]]}],
    )
    answers = read_answers(tmp_path / "vlm")
    assert answers is not None
    (ranking,) = answers.rankings
    assert ranking.places == {"a": pytest.approx(4 / 3), "b": pytest.approx(5 / 3)}
    assert ranking.sure == [("a", "b", 0.9), ("b", "a", 0.6), ("a", "b", 0.8)]


def test_the_studys_rooms_import_one_way():
    home = Path(needlehoop.__file__).parent / "study"
    rooms = ("data", "stats", "render", "report")
    for number, room in enumerate(rooms):
        for path in (home / room).glob("*.py"):
            text = path.read_text()
            assert not [name for name in rooms[number + 1 :] if f"needlehoop.study.{name}" in text]
