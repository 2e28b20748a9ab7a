"""The end of a server, seen in a real browser: of a process of its own, and with no other tab."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from browser import PATIENCE, tab_at
from playwright.sync_api import Browser, expect

expect.set_options(timeout=PATIENCE)

ROOT = Path(__file__).parents[2]
SERVE = (sys.executable, "-m", "hebbviz", "serve", "--no-browser", "--port", "0")

LOSE_GRAPHICS = """for (const canvas of document.querySelectorAll('canvas'))
  canvas.getContext('webgl2')?.getExtension('WEBGL_lose_context').loseContext()"""


@pytest.mark.slow
def test_the_page_says_that_its_graphics_and_then_its_server_are_gone(browser: Browser) -> None:
    with subprocess.Popen(
        [*SERVE, "--speed", "50"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        try:
            said = ""
            while "hebbviz is at" not in said:
                said = server.stdout.readline()
                assert said, "the server ended"
            with tab_at(browser, said.split()[3], width=1100, height=640) as page:
                lost = page.get_by_text("Reload the page")
                expect(lost).not_to_be_visible()
                page.evaluate(LOSE_GRAPHICS)
                expect(lost).to_be_visible()
                lost.click()
                expect(page.get_by_text("steps/s").first).to_be_visible()
                expect(lost).not_to_be_visible()
                gone = page.get_by_text(
                    re.compile("connection to the server is lost", re.IGNORECASE)
                )
                expect(gone).to_have_count(1)
                expect(gone).not_to_be_visible()
                server.send_signal(signal.SIGKILL)
                expect(gone).to_be_visible()
        finally:
            server.kill()
