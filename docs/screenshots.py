"""Takes the pictures of the console's page from a demo, at moments that its words tell.

make screenshots
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

DOCS = Path(__file__).resolve().parent

LIMIT = 240_000
"""Time [ms] for a moment to come: a choice, the whole demo."""

SPEEDUP = 4.0
"""Simulated seconds per second: slow enough for a picture of a moment."""


def main() -> int:
    """Fly the demo and take all pictures."""
    command = [sys.executable, '-m', 'uav_mission_manager.cli.demo', f'--speedup={SPEEDUP}']
    demo = subprocess.Popen(command, cwd=DOCS.parent, stdout=subprocess.PIPE, text=True)
    assert demo.stdout is not None
    address = ''
    try:
        while not address:
            line = demo.stdout.readline()
            if not line or 'No page' in line:
                raise RuntimeError(f'the demo has no page: {line}')
            address = line.partition('on a page: ')[2].strip()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which('chromium'), args=['--no-sandbox']
            )
            _take_all(browser, address)
            browser.close()
    finally:
        demo.terminate()
        demo.communicate()
    return 0


def _take_all(browser: Browser, address: str) -> None:
    """Take each picture when its moment has come, in the order of the demo."""
    light = _open(browser, address, 'light', 1366, 768)
    dark = _open(browser, address, 'dark', 1366, 768)
    dark.keyboard.press('c')
    tablet = _open(browser, address, 'light', 1024, 768)
    _when(light, '.now .headline', 'goal2, EVADING')
    light.wait_for_timeout(500)
    _take(light, 'console')
    _when(dark, '.now .headline', 'REPAIR')
    dark.wait_for_timeout(500)
    _take(dark, 'console_dark')
    _when(tablet, '.now .headline', 'RECHARGE')
    tablet.wait_for_timeout(500)
    _take(tablet, 'console_tablet')


def _open(browser: Browser, address: str, scheme: str, width: int, height: int) -> Page:
    size = {'width': width, 'height': height}
    page = browser.new_page(viewport=size, color_scheme=scheme)
    page.goto(address)
    return page


def _when(page: Page, part: str, text: str) -> None:
    page.locator(part).filter(has_text=text).wait_for(timeout=LIMIT)


def _take(page: Page, name: str) -> None:
    page.screenshot(path=DOCS / f'{name}.png')
    print(f'wrote docs/{name}.png')


if __name__ == '__main__':
    raise SystemExit(main())
