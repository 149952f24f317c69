"""An operator in a real browser, on the page of a live simulated cell: from start to report by
clicks, by keyboard alone, on a phone in the dark beside it, with STOP in each phase, and with the
connection cut.

Arguments: the page's address with its token, the process id of the service, a folder for pictures.
Prints one JSON object. Exit code 77: the browser, its driver or selenium is missing.
"""

import json
import os
import signal
import sys
import time

from ui_driver import (
    CLICK_STOP_IN, browser, click, close_all, element, ended, in_phase, open_live, picture, severe, start, text, wait,
)
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

ADDRESS, SERVICE = sys.argv[1], int(sys.argv[2])
found = {"stopped_in": []}


def start_and_stop_in(word):
    """Starts the task on the desk, and clicks STOP on the phone when its page shows this phase."""
    phone.execute_script(CLICK_STOP_IN, word)
    start(desk)
    wait(f"STOP in {word}", lambda: phone.execute_script("return window.stopped_in") == word)
    ended(desk)
    found["stopped_in"].append(word)


def stop_on_phone(word):
    in_phase(phone, word)
    element(phone, "stop").click()
    ended(desk)
    found["stopped_in"].append(word)


desk, phone = browser("desk"), browser("phone", phone=True)
try:
    phone.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]})
    open_live(desk, ADDRESS)
    open_live(phone, ADDRESS.split("#")[0])
    found["token_in_address"] = "token" in desk.current_url
    found["you"] = [text(desk, "you"), text(phone, "you")]

    # From start to done by clicks. The first attempt is stopped by the phone, which has no token.
    wait("tasks are listed", lambda: len(Select(element(desk, "tasks")).options) == 2)
    Select(element(desk, "tasks")).select_by_value("wipe.toml")
    start_and_stop_in("Standing still")
    start(desk)
    in_phase(desk, "Done")
    wait("the whole path was driven", lambda: text(desk, "percent") == "100 %")
    picture(desk, "done")
    found["webgl"] = [not element(driver, "no-scene").is_displayed() for driver in (desk, phone)]

    # A longer task, seen on both, paused and resumed.
    Select(element(desk, "tasks")).select_by_value("long.toml")
    start(desk)
    in_phase(desk, "Sliding")
    in_phase(phone, "Sliding")
    wait("dose is painted", lambda: "cm² touched" in text(desk, "dose-words"))
    wait("the force is shown", lambda: float(text(desk, "force-now").split()[0]) > 1.0)
    click(desk, "view-surface")
    click(desk, "pause")
    in_phase(phone, "Paused")
    picture(desk, "paused")
    click(desk, "resume")
    in_phase(phone, "Sliding")
    found["phone_may"] = {name: element(phone, name).is_enabled() for name in ("start", "pause", "stop")}
    found["phone_width"] = phone.execute_script("return document.documentElement.scrollWidth")
    found["phone_dark"] = phone.execute_script("return getComputedStyle(document.body).backgroundColor")
    found["phone_stop"] = phone.execute_script(
        "const r = document.getElementById('stop').getBoundingClientRect(); return [r.top, r.bottom, innerHeight]")
    picture(phone, "phone")

    # The phone stops it in further phases.
    click(desk, "pause")
    stop_on_phone("Paused")
    for phase in ("Approaching", "Touching down", "Sliding"):
        start_and_stop_in(phase)
    Select(element(desk, "tasks")).select_by_value("wipe.toml")
    for phase in ("Pressing and standing", "Retracting"):
        start_and_stop_in(phase)

    # The service is silent for a while, as if the connection was cut.
    os.kill(SERVICE, signal.SIGSTOP)
    try:
        wait("the page says that it is cut off", lambda: element(desk, "banner").is_displayed())
        time.sleep(0.5)
        found["cut"] = text(desk, "banner")
        picture(desk, "cut")
    finally:
        os.kill(SERVICE, signal.SIGCONT)
    wait("the page is live again", lambda: text(desk, "link") == "live")

    # By keyboard alone.
    desk.refresh()
    wait("the page is live", lambda: text(desk, "link") == "live")
    wait("the task can be started", element(desk, "start").is_enabled)
    reached = []

    def press(key):
        ActionChains(desk).send_keys(key).perform()

    for _ in range(12):
        press(Keys.TAB)
        reached.append(desk.switch_to.active_element.get_attribute("id"))
        if reached[-1] == "tasks":
            press("l")
        if reached[-1] == "start":
            break
    found["reached"] = reached
    press(Keys.ENTER)
    wait("the task runs", lambda: not element(desk, "start").is_enabled())
    press(Keys.ESCAPE)
    ended(desk)

    # The report of what was recorded.
    click(desk, "list-recordings")
    made = "const make = document.querySelector('#recordings button'); make?.click(); return make != null"
    wait("a recording is listed", lambda: desk.execute_script(made))
    wait("the report is there", lambda: desk.find_elements(By.CSS_SELECTOR, "#recordings a"))
    link = desk.find_element(By.CSS_SELECTOR, "#recordings a").get_attribute("href")
    desk.get(link)
    found["report"] = desk.title or desk.find_element(By.TAG_NAME, "body").text[:60]
    picture(desk, "report")
    # The service was silent for a while, and the phone has no WebGL.
    found["errors"] = severe(desk, phone, expected=("ERR_", "WebGL"))
    print(json.dumps(found))
finally:
    close_all()
