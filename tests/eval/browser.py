"""A headless Chromium that draws with the processor, for tests and measurements of pages."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
ABSENT = "no Chromium with its chromedriver on this machine (Debian: chromium, chromium-driver)"
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
    "--window-size=1280,900",
]
# Until every view that was asked to draw has drawn, and none shows the fewer triangles of what moves.
AT_REST = """
const done = arguments[0];
const wait = () => [...replays.values()].every(({ view }) => !view || !(view.pending || view.moving))
  ? requestAnimationFrame(() => setTimeout(done, 50)) : setTimeout(wait, 20);
requestAnimationFrame(() => requestAnimationFrame(wait));
"""


def open_browser(profile: Path) -> Any:
    """A Chrome of selenium with its profile in that folder; ask for CHROMIUM and DRIVER first."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER, log_output=subprocess.DEVNULL)
    chrome = webdriver.Chrome(options=options, service=service)
    chrome.set_script_timeout(60)
    return chrome
