"""An engineer teaches a task by hand in a real browser, saves it, and starts it. Another process
moves the simulated arm like a hand, when it sees what was taken.

Arguments: the page's address with its token, the process id of the service, a folder for pictures.
Prints one JSON object. Exit code 77: the browser, its driver or selenium is missing.
"""

import json
import sys
import time

from ui_driver import (
    browser, click, close_all, element, in_phase, moved, open_live, picture, severe, snapshot, text, tool, wait,
)
from selenium.webdriver.support.ui import Select

ADDRESS = sys.argv[1]
found = {}


def press(step, words):
    """Presses a button, and waits for the state in words."""
    click(desk, f"teach-{step}")
    wait(f"{step}: {words}", lambda: words in text(desk, "teach-state"))


def free():
    click(desk, "teach-begin")
    wait("the arm is free", lambda: element(desk, "teach-free").is_displayed())
    wait("the bridge says so", lambda: "a hand guides" in text(desk, "lights"))


def fill(name, value):
    field = element(desk, f"teach-{name}")
    field.clear()
    field.send_keys(str(value))


desk, phone = browser("desk"), browser("phone", phone=True)
try:
    open_live(desk, ADDRESS)
    open_live(phone, ADDRESS.split("#")[0])
    found["phone_teaches"] = element(phone, "teach-panel").is_displayed()

    free()
    found["start_while_free"] = snapshot(ADDRESS)["teach"]["who"]
    at = tool(ADDRESS)
    press("point", "1 points")
    at = moved(ADDRESS, at, 0.015)
    press("point", "2 points")
    press("stroke", "A stroke is being taken")
    at = moved(ADDRESS, at, 0.008)
    press("stroke", "1 strokes")
    at = moved(ADDRESS, at, 0.03)
    press("point", "3 points")
    press("undo", "2 points, 1 strokes")
    press("home", "Home is taken")
    marks = "return document.getElementById('scene').dataset.taught"
    found["drawn"] = wait("the marks are drawn", lambda: desk.execute_script(marks) == "4" and "4")
    click(desk, "view-surface")
    desk.execute_script("document.getElementById('scene').scrollIntoView({ block: 'center' })")
    time.sleep(1)
    picture(desk, "taught-scene")
    desk.execute_script("document.getElementById('teach-panel').scrollIntoView({ block: 'center' })")
    picture(desk, "teach")

    # A name that is taken is asked for first; another one is saved.
    fill("force", 4)
    fill("clearance", 10)
    fill("name", "wipe")
    click(desk, "teach-save")
    wait("it asks before it replaces", lambda: element(desk, "teach-replace").is_displayed())
    found["exists"] = text(desk, "teach-answer")
    found["still_free"] = element(desk, "teach-free").is_displayed()
    fill("name", "shown")
    click(desk, "teach-save")
    wait("it is saved", lambda: "shown.toml" in text(desk, "teach-answer"))
    wait("the arm is held", lambda: not element(desk, "teach-free").is_displayed())
    found["chosen"] = Select(element(desk, "tasks")).first_selected_option.get_attribute("value")

    # It is among the tasks, and runs from where the hand left the arm.
    wait("the arm is ready", lambda: "Ready to move" in text(desk, "lights"))
    click(desk, "start")
    in_phase(desk, "Moving to the start pose")
    in_phase(desk, "Sliding")
    in_phase(desk, "Done")
    found["percent"] = text(desk, "percent")

    # The page is lost while the arm is free: the arm holds itself.
    free()
    press("point", "1 points")
    began = time.monotonic()
    desk.get("about:blank")
    wait("the arm holds itself", lambda: not snapshot(ADDRESS)["teach"]["free"])
    found["held_after_s"] = time.monotonic() - began
    found["kept_points"] = snapshot(ADDRESS)["teach"]["points"]
    open_live(desk, ADDRESS)
    wait("why is shown", lambda: "no sign of life" in text(desk, "teach-state"))
    found["errors"] = severe(desk, phone, expected=("ERR_", "WebGL"))
    print(json.dumps(found))
finally:
    close_all()
