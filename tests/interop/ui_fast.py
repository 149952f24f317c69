"""The page of a cell at 500 Hz in a real browser: rates, ages and missed cycles, and STOP while the
tool seeks a surface that it has lost.

Arguments: the page's address with its token, the process id of the service, a folder for pictures.
Prints one JSON object. Exit code 77: the browser, its driver or selenium is missing.
"""

import json
import re
import sys

from ui_driver import CLICK_STOP_IN, RECORD_PHASES, browser, close_all, ended, has_shown, open_live, picture
from ui_driver import severe, start, text, wait

ADDRESS = sys.argv[1]
found = {}


def figures(name, pattern):
    """The numbers in the light of a part, once it has this form."""
    row = f"return [...document.querySelectorAll('#lights li')].find((r) => r.querySelector('b').textContent === '{name}')?.textContent"
    match = wait(f"{name}: {pattern}", lambda: re.search(pattern, desk.execute_script(row) or ""))
    return [float(number) for number in match.groups()]


desk = browser("desk")
try:
    open_live(desk, ADDRESS)
    desk.execute_script(RECORD_PHASES)
    desk.execute_script(CLICK_STOP_IN, "seeking")
    start(desk)
    wait("it slides", lambda: has_shown(desk, "Sliding"))
    found["robot"] = figures("Robot", r"(\d+) states a second, the newest is (\d+) ms old")
    found["controller"] = figures("Controller", r"(\d+) cycles a second, (\d+) missed in all, its state is (\d+) ms old")
    picture(desk, "fast")
    wait("STOP while it seeks", lambda: desk.execute_script("return window.stopped_in") == "seeking")
    ended(desk)
    found["after"] = text(desk, "phase")
    found["errors"] = severe(desk, expected=("ERR_",))
    print(json.dumps(found))
finally:
    close_all()
