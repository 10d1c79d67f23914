"""Which runs a sweep's words stand for."""

import pytest

from needlehoop.study.data.records import Place
from needlehoop.training.planned import planned


def test_planned_runs_are_those_that_the_words_sweep_over():
    words = ["cams=[rgb_front, dep_side],[seg_side]", "reward=human,sparse", "seed=2"]
    assert [*planned(words)] == [
        Place("rgb_front+dep_side", "human", 2),
        Place("rgb_front+dep_side", "sparse", 2),
        Place("seg_side", "human", 2),
        Place("seg_side", "sparse", 2),
    ]
    full, table2, paid = (
        {*planned([f"experiment={name}"])} for name in ("full", "table2", "rewards")
    )
    assert table2 < full
    assert (len(full), len(table2)) == (20, 14)
    # Those of another model than the paper's.
    assert {place.reward for place in paid - full} == {"vlm_text_claude", "vlm_img_claude"}
    assert (len(paid), len(paid - full)) == (12, 6)


def test_runs_that_an_expert_teaches_are_planned_by_their_algorithm():
    found = planned(["algo=dagger", "cams=[seg_side]", "seed=0,1"])
    assert [*found] == [Place("seg_side", "expert", 0), Place("seg_side", "expert", 1)]
    assert found[Place("seg_side", "expert", 0)] == {"steps": "64000"}
    imitation = planned(["experiment=imitation"])
    assert len(imitation) == 17 * 3
    table2 = {place.cameras for place in planned(["experiment=table2"])}
    assert table2 <= {place.cameras for place in imitation}


def test_an_experiment_may_build_on_another_and_an_option_is_its_settings():
    robust = planned(["experiment=robust"])
    assert len(robust) == 17 * 2 * 2
    place = Place("seg_default", "expert+disturb-moderate", 13)
    assert robust[place]["disturb.robot.lost"] == "0.05"
    wide = planned(["task=wide", "cams=seg_default"])[Place("seg_default", "human", 0)]
    assert wide["task.needle_yaw_range"] == robust[place]["task.needle_yaw_range"] == "0.45"


def test_a_name_for_several_cameras_is_planned_as_their_run():
    names = {place.cameras for place in planned(["cams=stereo,[rgb_front,rgb_wrist]"])}
    assert names == {"rgb_ecm_left+rgb_ecm_right", "rgb_front+rgb_wrist"}


def test_a_study_of_own_cameras_is_planned_with_their_folder(tmp_path):
    (tmp_path / "conf/view").mkdir(parents=True)
    (tmp_path / "conf/view/near.yaml").write_text("azimuth: 0.0\n")
    words = ["cams=rgb_near", f"conf_dir={tmp_path}/conf"]
    assert [*planned(words)] == [Place("rgb_near", "human", 0)]
    with pytest.raises(ValueError, match="cams/rgb_near"):
        planned(words[:1])
