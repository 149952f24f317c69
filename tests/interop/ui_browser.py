"""An operator in a real browser, on the page of a live simulated cell: from start to report by
clicks, by keyboard alone, on a phone in the dark beside it, with STOP in each phase, and with the
connection cut.

Arguments: the page's address with its token, the process id of the service, a folder for pictures.
Prints one JSON object. Exit code 77: the browser, its driver or selenium is missing.
"""

import json
import os
import shutil
import signal
import sys
import time

try:
    from selenium import webdriver
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import Select
except ImportError:
    print("selenium is not installed")
    sys.exit(77)

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not (BROWSER and DRIVER):
    print("chromium or its driver is not installed")
    sys.exit(77)

ADDRESS, SERVICE, PICTURES = sys.argv[1], int(sys.argv[2]), sys.argv[3]
PATIENCE_S = 30
found = {"stopped_in": []}


def browser(phone=False):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    # The phone has no WebGL, as some have: the page works without the arm in space.
    drawing = ["--disable-3d-apis"] if phone else ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    for argument in ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1024,800", *drawing]:
        options.add_argument(argument)
    if phone:
        metrics = {"width": 390, "height": 844, "pixelRatio": 1.0, "touch": True}
        options.add_experimental_option("mobileEmulation", {"deviceMetrics": metrics})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    driver.set_script_timeout(PATIENCE_S)
    return driver


def wait(what, holds, patience_s=PATIENCE_S):
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        value = holds()
        if value:
            return value
        time.sleep(0.05)
    for driver, name in [(desk, "desk"), (phone, "phone")]:
        driver.save_screenshot(os.path.join(PICTURES, f"failed-{name}.png"))
        print(name, text(driver, "phase"), text(driver, "answer"), text(driver, "fault"), file=sys.stderr)
    raise AssertionError(f"{what}: not within {patience_s} s")


def element(driver, name):
    return driver.find_element(By.ID, name)


def text(driver, name):
    return element(driver, name).text


def click(driver, name):
    wait(f"{name} can be clicked", element(driver, name).is_enabled)
    # Away from the bars that stay in view.
    driver.execute_script("document.getElementById(arguments[0]).scrollIntoView({ block: 'center' })", name)
    element(driver, name).click()


def in_phase(driver, *words):
    return wait(f"{words}", lambda: any(word in text(driver, "phase") for word in words))


def ended(driver):
    in_phase(driver, "Done", "Ended", "Ready")


def picture(driver, name):
    driver.save_screenshot(os.path.join(PICTURES, f"{name}.png"))


def start(driver):
    """Starts the task by clicks, as soon as the cell takes it."""

    def begun():
        if element(driver, "start").is_enabled():
            click(driver, "start")
            time.sleep(0.3)
        return not element(driver, "start").is_enabled() or "Stop" in text(driver, "answer")

    wait("the task starts", begun)


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


# Some phases are shorter than the way of a request of the driver.
CLICK_STOP_IN = """
    const [phase, word] = [document.getElementById("phase"), arguments[0]];
    const watch = new MutationObserver(() => {
      if (!phase.textContent.includes(word)) return;
      watch.disconnect();
      document.getElementById("stop").click();
      window.stopped_in = word;
    });
    watch.observe(phase, { childList: true, characterData: true, subtree: true });
"""

desk, phone = browser(), browser(phone=True)
try:
    phone.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]})
    desk.get(ADDRESS)
    phone.get(ADDRESS.split("#")[0])
    for driver in (desk, phone):
        wait("the page is live", lambda: text(driver, "link") == "live")
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
    logs = desk.get_log("browser") + phone.get_log("browser")
    # The service was silent for a while, and the phone has no WebGL.
    expected = ("ERR_", "WebGL")
    severe = [one["message"] for one in logs if one["level"] == "SEVERE"]
    found["errors"] = [message for message in severe if not any(word in message for word in expected)]
    print(json.dumps(found))
finally:
    for driver in (desk, phone):
        driver.quit()
