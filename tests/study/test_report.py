"""The report, as text and opened in a browser."""

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from PIL import Image
from selenium.webdriver.common.by import By
from study_files import REWARDED, write_run, write_study

from needlehoop.cli.main import main
from needlehoop.config.composing import compose

EXAMPLES = Path(__file__).parents[2] / "examples" / "conf"


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    """Three camera sets, three rewards, a picture, a film, and a run to leave out."""
    folder = tmp_path_factory.mktemp("results") / "main"
    pairs = [(name, "human") for name in ("dep_front+seg_side", "rgb_default", "dep_default")]
    write_study(folder, [*pairs, *REWARDED[:2]], seeds=2)
    (folder / "dep_default" / "human" / "seed0" / "video.mp4").write_bytes(b"a film")
    (folder / "rgb_default" / "human" / "seed1" / "config.yaml").write_text("<a>: 1")
    (folder / "cameras").mkdir()
    for name in ("dep_front", "seg_side", "rgb_default", "dep_default"):
        Image.new("RGB", (128, 64), "red").save(folder / "cameras" / f"{name}.png")
    assert main(["report", str(folder)]) == 0
    return folder


def test_the_page_sorts_fits_and_asks_for_nothing(study, browser):
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    address = (study / "report.html").as_uri()
    # What the browser itself asked for before.
    browser.get_log("performance")
    browser.get(address)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    head = browser.find_elements(By.CSS_SELECTOR, "table.results th button")[4]
    assert head.text == "return"
    for rising in (True, False):
        browser.execute_script("arguments[0].click()", head)
        cells = browser.find_elements(By.CSS_SELECTOR, "table.results td:nth-child(5)")
        returns = [float(cell.get_attribute("textContent")) for cell in cells]
        assert returns == sorted(returns, reverse=not rising)
    assert browser.get_log("browser") == []
    events = [json.loads(row["message"])["message"] for row in browser.get_log("performance")]
    urls = [e["params"]["request"]["url"] for e in events if "requestWill" in e["method"]]
    assert [url for url in urls if not url.startswith("data:")] == [address]


def test_the_page_holds_agents_settings_commands_and_what_was_left_out(study):
    text = (study / "report.html").read_text()
    assert "9 runs, 9 finished" in text
    assert "rgb_default/human/seed1: config.yaml: has no cams" in text
    assert "1. dep_front+seg_side" in text
    assert 'alt="seg_side, start and goal"' in text
    assert text.count("data:video/mp4;base64,") == 1
    assert "gamma: 0.99" in text
    assert "vlm_text &amp; its &lt;source&gt;" in text
    assert "train.py &#39;cams=[dep_front,seg_side]&#39; seed=1" in text
    assert f"needlehoop report {study}" in text
    assert not re.search(r'(?:src|href)="(?!data:)', text)
    # What rewards make of the same cameras stands before all other figures.
    figures = re.findall(r'<figure class="(\w+)">', text)
    assert figures == ["rewards", "final_values", "learning_curves"]


def test_several_studies_stand_on_one_page(study, tmp_path, capsys):
    write_run(tmp_path / "other", "rgb_default", updates=20)
    assert main(["report", str(study), str(tmp_path / "other"), "--out", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    assert text.index("<h2>Study main</h2>") < text.index("<h2>Study other</h2>")
    assert "still in training" in text
    shutil.copytree(tmp_path / "other", tmp_path / "b" / "other")
    assert main(["report", str(tmp_path / "other"), str(tmp_path / "b" / "other")]) == 2
    assert "other, other are not different names" in capsys.readouterr().err


def test_cameras_without_a_picture_are_drawn_from_a_runs_own_settings(tmp_path):
    study = tmp_path / "main"
    run = write_run(study, "rgb_top", updates=20)
    values = compose(["cams=[rgb_top]", f"conf_dir={EXAMPLES}", "image_size=16"], "config")
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    assert main(["report", str(study)]) == 0
    with Image.open(study / "cameras" / "rgb_top.png") as image:
        assert image.size == (32, 16)
        assert len(image.getcolors()) > 3
    text = (study / "report.html").read_text()
    assert 'alt="rgb_top, start and goal"' in text
    assert "the paper&#39;s" not in text
