"""The page: its handles without a browser, and in ``make test-all`` by clicks in Chromium."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

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
    yield address, process
    process.kill()
    process.wait()
    process.stdout.close()


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


@pytest.mark.full
def test_a_second_tab_shows_the_same_and_closing_it_ends_nothing(browser, studio):
    address, process = studio
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
    _, process = studio
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0
    output = process.stdout.read()
    assert "studio: closed" in output
    assert "Traceback" not in output
