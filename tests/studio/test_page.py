"""The page: its handles without a browser, and in ``make test-all`` by clicks in Chromium."""

from __future__ import annotations

import io
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from PIL import Image
from selenium import webdriver
from selenium.webdriver import ActionChains
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait
from tiny_runs import TINY, composed, run_composed

from needlehoop.config import composing
from needlehoop.envs.settings import compose_settings
from needlehoop.studio.page import Page, Source
from needlehoop.studio.players import players
from needlehoop.studio.world import World

LAYOUTS = ("standard", "near")


@pytest.fixture
def page(settings, tmp_path):
    choices = players(settings, None, False, torch.device("cpu"))
    levels = composing.compose((), "studio")["levels"]
    world = World(settings, choices, levels, "rgb", "expert", size=64)
    source = Source(
        layouts={name: lambda name=name: compose_settings([f"task={name}"]) for name in LAYOUTS},
        words=["task=near"],
        conf_dir=str(tmp_path / "mine"),
        results=str(tmp_path / "results"),
    )
    opened = Page(world, source, "127.0.0.1", 0)
    opened.show(world.tick())
    yield opened
    opened.close()


def test_handles_move_the_chosen_camera_and_save_it(page, capsys):
    page.view.value = "side"
    page.position.value = (0.0, -300.0, 250.0)
    page.fovy.value = 30.0
    page.aim.value = True
    view = page.world.wish.settings.views["side"]
    assert (view.position, view.fovy, view.azimuth) == ((0.0, -0.3, 0.25), 30.0, None)
    assert view.forward[1] > -view.forward[2] > 0.5
    page.rendering.value = "seg"
    page.name.value = "from_above"
    page.save()
    path = Path(page.folder.value) / "view/from_above.yaml"
    assert f"{path}\npython train.py conf_dir={path.parents[1]} cams=seg_from_above task=near" in (
        capsys.readouterr().out
    )
    with pytest.raises(ValueError, match="exists"):
        page.save()


def test_handles_show_the_world_and_do_not_answer_themselves(page):
    world = page.world
    before = world.wish
    page.show(world._frame(before))
    assert world.wish == before
    tip = world._frame(before).hand.tip
    np.testing.assert_allclose([1e3 * x for x in tip], [s.value for s in page.sliders[:3]])
    page.sliders[0].value += 4.0
    for _ in range(4):
        page.show(world.tick())
    assert page.player.value == "by hand"
    np.testing.assert_allclose(world._frame(before).hand.tip[0], tip[0] + 4e-3, atol=1e-9)
    page.axis.value = "picture.blur"
    page.severity.value = 5
    assert world.wish.settings.disturb.picture == {"blur": world.ladder["picture.blur"][5]}
    page.layout.value, page.seed.value = "near", 5
    near = compose_settings(["task=near"]).task
    assert (world.wish.settings.task, world.wish.settings.seed) == (near, 5)
    page.show(world.tick())


def test_pixels_are_counted_on_the_page(page):
    page.count_pixels()
    rows = page.pixels.content.splitlines()[2:]
    assert len(rows) == 9
    assert all(re.fullmatch(r"\| \w+ \| \w+ \| \d+ \| (\d+%|–) \|", row) for row in rows)


@pytest.mark.full
def test_a_closed_page_stops_its_probe(page):
    page._is_closed = True
    with pytest.raises(RuntimeError, match="closed"):
        page.probe()


# By clicks.


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """The address of the command, as a person starts it, and its process."""
    folder = tmp_path_factory.mktemp("studio")
    words = ["port=0", "conf_dir=mine", f"results={folder}"]
    (folder / "mine").mkdir()
    command = [sys.executable, "-m", "needlehoop.cli.main", "studio", *words]
    # A folder of its own; the package is the one under test.
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    process = subprocess.Popen(
        command, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    output = ""
    while "Ctrl-C ends it" not in output:
        assert process.poll() is None, output
        assert select.select([process.stdout], [], [], 90)[0], output
        output += process.stdout.readline()
    address = re.search(r"http://127\.0\.0\.1:\d+", output)[0]
    yield address, process, folder
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no chromium and chromedriver here: apt-get install chromium chromium-driver")
    options = Options()
    options.binary_location = chromium
    flags = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1600,1000"]
    flags += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += [f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"]
    for flag in flags:
        options.add_argument(flag)
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    yield chrome
    chrome.quit()


def click(browser, text: str) -> None:
    xpath = f"//*[self::button or @role='tab'][normalize-space()='{text}']"
    WebDriverWait(browser, 30).until(lambda b: b.find_elements(By.XPATH, xpath))
    browser.find_element(By.XPATH, xpath).click()


def fields(browser, label: str) -> list:
    """The inputs of a handle."""
    xpath = f"//label[normalize-space()='{label}']"
    WebDriverWait(browser, 30).until(lambda b: b.find_elements(By.XPATH, xpath))
    row = browser.find_element(By.XPATH, xpath)
    while not (inputs := row.find_elements(By.TAG_NAME, "input")):
        row = row.find_element(By.XPATH, "..")
    return inputs


def fill(field, text: str) -> None:
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys(text, Keys.ENTER)
    # The page waits a moment for more to be typed.
    time.sleep(0.5)


def until(browser, pattern: str, seconds: float = 60) -> str:
    """The page's text, once a pattern is in it."""
    body = browser.find_element(By.TAG_NAME, "body")
    WebDriverWait(browser, seconds).until(lambda _: re.search(pattern, body.text))
    return body.text


def drag_up(browser) -> None:
    """Pull the handle's green arrow, which moves the camera up in its image."""
    shot = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")
    scene = np.asarray(shot, int)[:, 480:1270]
    rows, columns = np.nonzero(np.abs(scene - (120, 215, 158)).max(-1) < 22)
    tip = rows.argmin()
    x, y = int(columns[tip]) + 480, int(rows[tip]) + 6
    mouse = ActionChains(browser)
    mouse.w3c_actions.pointer_action.move_to_location(x, y).pointer_down()
    for part in (1, 2, 3):
        mouse.w3c_actions.pointer_action.move_to_location(x - 8 * part, y - 15 * part)
    mouse.w3c_actions.pointer_action.pause(1).pointer_up()
    mouse.perform()


@pytest.mark.full
def test_a_camera_is_dragged_saved_and_trains(browser, studio):
    address, _, folder = studio
    browser.get(address)
    until(browser, "Judge")
    height = fields(browser, "position, mm")[2]
    before = float(height.get_attribute("value"))
    time.sleep(3)
    drag_up(browser)
    WebDriverWait(browser, 30).until(lambda _: float(height.get_attribute("value")) > before + 10)
    fill(fields(browser, "position, mm")[0], "-50")
    fill(fields(browser, "field of view, °")[-1], "22")
    click(browser, "Aim at the middle")
    fill(fields(browser, "name")[0], "clicked")
    click(browser, "Save view")
    until(browser, "cams=rgb_clicked")
    view = yaml.safe_load((folder / "mine/view/clicked.yaml").read_text())
    assert (view["position"][0], view["fovy"]) == (-0.05, 22.0)
    assert view["position"][2] > before / 1e3 + 0.01
    words = [word for word in TINY if not word.startswith(("obs=", "steps="))]
    seen = ["image_size=16", "steps=8", f"results={folder}", f"conf_dir={folder / 'mine'}"]
    run_composed(composed("cams=rgb_clicked", *words, *seen))
    assert (folder / "main/rgb_clicked/sparse/seed0/policy.safetensors").exists()


@pytest.mark.full
def test_a_second_tab_shows_the_same_and_closing_it_ends_nothing(browser, studio):
    address, process, _ = studio
    browser.get(address)
    first = browser.current_window_handle
    click(browser, "Arm")
    browser.switch_to.new_window("tab")
    browser.get(address)
    click(browser, "Arm")
    fill(fields(browser, "episode seed")[0], "3")
    click(browser, "Play")
    status = re.search("step .*success.*", until(browser, "step .*success"))[0]
    browser.close()
    browser.switch_to.window(first)
    assert status in until(browser, "success")
    click(browser, "Judge")
    click(browser, "Count pixels")
    until(browser, "front robot [1-9]")
    click(browser, "Ask a model")
    until(browser, "request.md")
    assert process.poll() is None


@pytest.mark.full
def test_ctrl_c_ends_in_order(studio):
    _, process, _ = studio
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0
    output = process.stdout.read()
    assert "studio: closed" in output
    assert "Traceback" not in output
