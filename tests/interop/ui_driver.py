"""What the scripts that work with the operator's page in a real browser share: the browsers, and
what a person does on the page.

Exit code 77: the browser, its driver or selenium is missing.
"""

import json
import math
import os
import shutil
import sys
import time
import urllib.request

try:
    from selenium import webdriver
    from selenium.webdriver.common.by import By
except ImportError:
    print("selenium is not installed")
    sys.exit(77)

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not (BROWSER and DRIVER):
    print("chromium or its driver is not installed")
    sys.exit(77)

PATIENCE_S = 30
PICTURES = sys.argv[3]
opened = {}


def browser(name, phone=False):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    # The phone has no WebGL, as some have: the page works without the arm in space.
    drawing = ["--disable-3d-apis"] if phone else ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    # As on a machine without a graphics card: only the arm in space is drawn by its software.
    drawing += ["--disable-gpu-compositing", "--disable-accelerated-2d-canvas"]
    for argument in ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1024,800", *drawing]:
        options.add_argument(argument)
    if phone:
        metrics = {"width": 390, "height": 844, "pixelRatio": 1.0, "touch": True}
        options.add_experimental_option("mobileEmulation", {"deviceMetrics": metrics})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    driver.set_script_timeout(PATIENCE_S)
    opened[name] = driver
    return driver


def close_all():
    for driver in opened.values():
        driver.quit()


def wait(what, holds, patience_s=PATIENCE_S):
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        value = holds()
        if value:
            return value
        time.sleep(0.05)
    for name, driver in opened.items():
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


def open_live(driver, address):
    driver.get(address)
    wait("the page is live", lambda: text(driver, "link") == "live")


# Some phases are shorter than the way of a request of the driver, so the page itself keeps those that
# it has shown, or clicks STOP in one.
RECORD_PHASES = """
    const phase = document.getElementById("phase");
    window.phases = [phase.textContent];
    const watch = new MutationObserver(() => window.phases.push(phase.textContent));
    watch.observe(phase, { childList: true, characterData: true, subtree: true });
"""


def has_shown(driver, word):
    """Whether the page has shown a phase with this word since `RECORD_PHASES`."""
    return any(word in phase for phase in driver.execute_script("return window.phases"))


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


def severe(*drivers, expected):
    """Errors in the browsers' logs without one of the expected words."""
    logs = [one for driver in drivers for one in driver.get_log("browser")]
    messages = [one["message"] for one in logs if one["level"] == "SEVERE"]
    return [message for message in messages if not any(word in message for word in expected)]


def snapshot(address):
    """The newest of what the page is sent."""
    host = address.split("/#")[0]
    with urllib.request.urlopen(f"{host}/api/stream", timeout=PATIENCE_S) as stream:
        for line in stream:
            if line.startswith(b"data: "):
                return json.loads(line[6:])


def tool(address):
    """Place of the tool, world axes, m."""
    return snapshot(address)["space"]["joints"][-1]


def moved(address, before, by_m):
    """Waits until the tool has moved by so much, and rests."""
    last = [before]

    def rests():
        now = tool(address)
        far, still = math.dist(now, before) > by_m, math.dist(now, last[0]) < 1e-4
        last[0] = now
        return far and still and now

    return wait(f"the tool has moved by {by_m} m", rests)
