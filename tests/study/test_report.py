"""The report, opened in a browser."""

import json
import re
import shutil
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
import yaml
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from study_files import REWARDED, write_answers, write_run, write_study

from needlehoop.cli.main import main
from needlehoop.config.composing import compose
from needlehoop.study.report import page

EXAMPLES = Path(__file__).parents[2] / "examples" / "conf"

_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)

_PLAY = """
const done = arguments[arguments.length - 1], film = document.querySelector("video");
film.addEventListener("timeupdate", () => film.currentTime > 0 && done("played"));
film.addEventListener("error", () => done(film.error.message));
film.play().catch((error) => done(String(error)));
"""


_CUT_OFF = """
const cut = [];
for (const one of document.querySelectorAll("main *")) {
  const said = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  const box = one.getBoundingClientRect();
  if (!said || !box.width || one.closest(".wide, pre")) continue;
  const hidden = getComputedStyle(one).overflowX === "hidden" && one.scrollWidth > one.clientWidth;
  if (hidden || box.right > innerWidth + 1) cut.push(one.textContent.trim());
}
return cut;
"""
"""Text that ends outside the window, or is hidden; tables and settings have a frame to scroll."""

_SHOWN = """
const all = [...document.querySelectorAll(arguments[0])].filter((one) => !one.hidden);
return all.map((one) => one.dataset.part ?? one.dataset.reward);
"""


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("film") / "video.mp4"
    with imageio.get_writer(out, fps=20) as writer:
        for i in range(20):
            frame = np.zeros((48, 64, 3), np.uint8)
            frame[:, 2 * i : 2 * i + 8] = 255
            writer.append_data(frame)
    return out


@pytest.fixture(scope="module")
def study(tmp_path_factory, film) -> Path:
    """Five camera sets, three rewards, two seeds, films, answers, and things to leave out."""
    folder = tmp_path_factory.mktemp("results") / "main"
    pairs = [(name, "human") for name in ("dep_front+seg_side", "rgb_front+seg_side")]
    pairs += [(name, "human") for name in ("dep_front+rgb_side", "rgb_default", "dep_default")]
    write_study(folder, [*pairs, *REWARDED[:2]], seeds=2)
    write_answers(folder)
    for name in ("dep_front+seg_side", "dep_default"):
        for seed in (0, 1):
            shutil.copy(film, folder / name / "human" / f"seed{seed}" / "video.mp4")
    (folder / "rgb_default" / "human" / "seed1" / "config.yaml").write_text("")
    (folder / "<notes>").symlink_to(film.parent)
    assert main(["report", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Debian's Chromium, through its own driver: nothing is downloaded."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no chromium and chromedriver here: apt-get install chromium chromium-driver")
    options = Options()
    options.binary_location = chromium
    for flag in _FLAGS:
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('chromium')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    yield found
    found.quit()


def open_page(browser, page: Path, width: int) -> None:
    size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(page.as_uri())


def column(browser, table: str, number: int) -> list[str]:
    cells = browser.find_elements(By.CSS_SELECTOR, f"#{table} td:nth-child({number})")
    return [cell.get_attribute("textContent") for cell in cells]


def requests(browser) -> list[str]:
    """Addresses that the page asked for, those inside it aside."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [request["url"] for request in asked if not request["url"].startswith("data:")]


def test_the_page_sorts_plays_and_asks_for_nothing(browser, study):
    browser.get_log("performance")
    page = study / "report.html"
    open_page(browser, page, 1200)
    places = column(browser, "results", 1)
    # Five sets with the human reward, then two other rewards with one each.
    assert places == ["1", "2", "3", "4", "5", "1", "1"]
    returns = [float(cell) for cell in column(browser, "results", 3)]
    assert returns[:5] == sorted(returns[:5], reverse=True)
    heads = browser.find_elements(By.CSS_SELECTOR, "#results th button")
    heads[2].click()
    assert [float(cell) for cell in column(browser, "results", 3)] == sorted(returns)
    heads[2].click()
    assert [float(cell) for cell in column(browser, "results", 3)] == sorted(returns)[::-1]
    assert column(browser, "results", 2)[0] != "dep_default"
    heads[1].click()
    names = column(browser, "results", 2)
    assert names == sorted(names)
    assert names[0] == "dep_default"
    images = browser.find_elements(By.TAG_NAME, "img")
    assert len(images) == 4
    assert all(image.get_property("naturalWidth") > 100 for image in images)
    browser.set_script_timeout(20)
    assert browser.execute_async_script(_PLAY) == "played"
    assert browser.get_log("browser") == []
    assert requests(browser) == [page.as_uri()]


@pytest.mark.parametrize("width", [390, 1400])
def test_the_page_fits_and_cuts_no_text_off(browser, study, width):
    open_page(browser, study / "report.html", width)
    browser.execute_script("document.querySelectorAll('details').forEach((one) => one.open = true)")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert browser.execute_script(_CUT_OFF) == []
    size = "return parseFloat(getComputedStyle(document.body).fontSize)"
    assert browser.execute_script(size) >= 16
    style = "style.cssText = 'width: 3rem; overflow: hidden; white-space: nowrap'"
    browser.execute_script(f"document.querySelector('h1').{style}")
    assert browser.execute_script(_CUT_OFF) == ["Study main"], "what is cut off is found"


def test_several_studies_have_a_switch(browser, study, sketched, tmp_path):
    root = tmp_path / "results"
    shutil.copytree(study, root / "main")
    write_study(root / "other", [("rgb_default", "human"), ("dep_default", "human")], seeds=1)
    tiles = root / "cameras"
    tiles.mkdir()
    for name in ("rgb_default", "dep_front"):
        Image.new("RGB", (128, 64), "red").save(tiles / f"{name}.png")
    (tiles / "seg_side.png").write_text("torn")
    assert main(["report", str(root / "main"), str(root / "other")]) == 0
    page = root / "main_and_other" / "report.html"
    open_page(browser, page, 1400)
    assert browser.execute_script(_SHOWN, ".part") == ["main"]
    # The study's three rewards have a switch of their own.
    assert browser.execute_script(_SHOWN, ".part:not([hidden]) .gallery") == ["human"]
    for name in ("VLM, text", "other"):
        switch = browser.find_element(By.CSS_SELECTOR, f"nav input[value='{name}']")
        browser.execute_script("arguments[0].click()", switch)
    assert browser.execute_script(_SHOWN, "[data-part=main] .gallery") == ["VLM, text"]
    assert browser.execute_script(_SHOWN, ".part") == ["other"]
    assert browser.find_elements(By.CSS_SELECTOR, "#main-results, #other-results")
    seen = browser.find_elements(By.CSS_SELECTOR, "[data-part=other] .sees img")
    assert [image.get_attribute("alt") for image in seen] == ["rgb_default, start and goal"]
    assert "seg_side.png is no picture, or cut off" in page.read_text()
    marks = re.findall(r' id="([^"]+)"', page.read_text())
    assert len(set(marks)) == len(marks)
    assert (page.parent / "figures" / "other" / "final_values.png").exists()


def test_studies_of_one_name_have_no_page_together(tmp_path, capsys):
    for where in ("a", "b"):
        write_run(tmp_path / where / "main", "rgb_default")
    words = ["report", str(tmp_path / "a" / "main"), str(tmp_path / "b" / "main")]
    for more in ([], ["--out", str(tmp_path / "c")]):
        assert main([*words, *more]) == 2
        assert "main, main are not different names" in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.html"))


@pytest.mark.full
def test_a_page_of_several_studies_is_beside_the_first_and_replaces_no_other(
    sketched, tmp_path, capsys
):
    for name in ("a", "b", "c"):
        write_run(tmp_path / name / name, "rgb_default")
    a, b, c = (str(tmp_path / name / name) for name in ("a", "b", "c"))
    (tmp_path / "a" / "report.html").write_text("of all studies")
    assert main(["report", a, b]) == 0
    assert main(["report", a, c]) == 0
    assert (tmp_path / "a" / "report.html").read_text() == "of all studies"
    pages = [tmp_path / "a" / name / "report.html" for name in ("a_and_b", "a_and_c")]
    said = capsys.readouterr().out.splitlines()
    assert all(str(page) in said and page.exists() for page in pages)


@pytest.mark.parametrize(
    ("cameras", "task"), [("rgb_top", "needle_hoop"), ("rgb_default", "reach")]
)
def test_a_study_of_ones_own_says_nothing_of_the_paper(sketched, tmp_path, cameras, task):
    study = tmp_path / "mine"
    for name in (cameras, "rgb_top+dep_low"):
        path = write_run(study, name) / "manifest.json"
        manifest = json.loads(path.read_text())
        path.write_text(json.dumps(manifest | {"task": {**manifest["task"], "name": task}}))
    assert main(["report", str(study)]) == 0
    page = (study / "report.html").read_text()
    # Its figure of final values, then its own ranking.
    ranking = page.index("<h2>Ranking</h2>")
    assert page.index('id="figure_final_values"') < ranking
    assert "1. rgb_" in page[ranking:]
    for theirs in ("the paper&#39;s", "regret", "claude", "Table II", "RGB and depth"):
        assert theirs not in page, theirs


def test_cameras_without_a_picture_are_drawn_from_a_runs_own_settings(sketched, tmp_path):
    study = tmp_path / "main"
    run = write_run(study, "rgb_top", updates=20)
    values = compose(["cams=[rgb_top]", f"conf_dir={EXAMPLES}", "image_size=16"], "config")
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    assert main(["report", str(study)]) == 0
    with Image.open(study / "cameras" / "rgb_top.png") as image:
        assert image.size == (32, 16)
        assert len(image.getcolors()) > 3
    page = (study / "report.html").read_text()
    assert 'alt="rgb_top, start and goal"' in page
    assert "no picture of" not in page
    drawn = (study / "cameras" / "rgb_top.png").stat().st_mtime_ns
    assert main(["report", str(study)]) == 0
    assert (study / "cameras" / "rgb_top.png").stat().st_mtime_ns == drawn
    assert (study / "report.html").read_text() == page


def test_the_papers_page_says_whose_numbers_it_shows(sketched, tmp_path):
    assert main(["report", "paper", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert "Not measured here" in page
    assert "one seed, no interval" in page
    _, _, table = page.partition('<section id="table_2"')
    assert table.partition("</section>")[0].count("<tr>") == 1 + 16


def test_the_page_holds_reasons_settings_commands_and_what_was_left_out(study):
    page = (study / "report.html").read_text()
    assert "Because of dep_front+seg_side." in page
    assert "Shows &lt;depth&gt; &amp; all." in page
    assert "Measured: place 1 of 2, return" in page
    assert "algo.gamma = 0.99" in page
    assert "vlm_text &amp; its &lt;source&gt;" in page
    assert "train.py &#39;cams=[dep_front,seg_side]&#39; seed=1" in page
    assert f"needlehoop report {study}" in page
    assert "2 left out" in page
    assert "rgb_default/human/seed1" in page
    assert "&lt;notes&gt;" in page
    assert not re.search(r'(?:src|href)="(?!data:)', page)


def test_without_answers_of_its_own_a_page_has_the_recorded_models_reasons(sketched, tmp_path):
    write_run(tmp_path / "main", "rgb_default")
    assert main(["report", str(tmp_path / "main")]) == 0
    page = (tmp_path / "main" / "report.html").read_text()
    assert "claude: RGB and depth" in page
    assert "One view without depth" in page
    assert "Measured: place 1 of 1, return" in page
    assert "Not run yet." in page


def test_a_study_of_rewards_begins_with_them(sketched, tmp_path):
    study = tmp_path / "main"
    write_study(study, [(cameras, "human") for cameras, _ in REWARDED[::2]], seeds=1)
    write_study(study, [REWARDED[0]], seeds=1)
    assert main(["report", str(study)]) == 0
    page = (study / "report.html").read_text()
    ranking = page.index("<h2>Ranking</h2>")
    first, second, later = (
        page.index(f'id="figure_{name}"') for name in ("rewards", "final_values", "learning_curves")
    )
    assert first < second < ranking < later
    # What rewards make of the same cameras stands before what models said of cameras.
    assert page.index('id="rewards"') < page.index('id="table_2"')


def test_films_of_the_best_and_the_worst_are_in_the_page(study, film):
    page = (study / "report.html").read_text()
    # Of the first seed of each set.
    assert page.count("data:video/mp4;base64,") == 2
    assert page.count("film, seed 0") == 2


def film_of(size: int) -> bytes:
    return b"moov".ljust(size, b"\0")


@pytest.fixture
def small(sketched, monkeypatch) -> None:
    """Pages have room for a third of the films' bytes."""
    monkeypatch.setattr(page, "_FILM", 600_000)
    monkeypatch.setattr(page, "_FILMS", 3_000_000)


def test_a_long_film_is_linked_to(small, tmp_path):
    for goal, size in enumerate((600_001, 500_000)):
        run = write_run(tmp_path / "main", f"rgb_{goal}", goal=2.0 * goal, updates=20)
        (run / "video.mp4").write_bytes(film_of(size))
    assert main(["report", str(tmp_path / "main"), "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "report.html").read_text()
    assert re.findall(r'href="(\.[^"]+)"', page) == ["../main/rgb_0/human/seed0/video.mp4"]
    assert page.count("data:video/mp4;base64,") == 1


def test_films_of_several_studies_take_turns(small, tmp_path):
    for study in ("first", "second"):
        for goal, name in enumerate(("dep_default", "rgb_default", "seg_default")):
            run = write_run(tmp_path / study, name, goal=2.0 * goal, updates=20)
            (run / "video.mp4").write_bytes(film_of(500_000))
    studies = [str(tmp_path / study) for study in ("first", "second")]
    assert main(["report", *studies, "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "report.html").read_text()
    linked = re.findall(r'href="\.\./(\w+)/([a-z]+)_default/human/seed0/video.mp4"', page)
    # Four find room: both ends of both rankings.
    middle = re.findall(r'class="cameras"><b>\d+\. ([a-z]+)_default', page)[1]
    assert sorted(linked) == [("first", middle), ("second", middle)]
    assert page.count("data:video/mp4;base64,") == 4
