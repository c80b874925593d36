"""Fly twice, report, and write the pictures of its page. Needs a Chromium and Playwright.

python tools/update_report_image.py PATH_OF_CHROMIUM
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from quad_mpc_ros.cli import main

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
SHOWN = {
    "report.png": ("path", "error", "inputs", "source"),
    "report_in_words.png": ("words",),
}
WEBGL = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def update(chromium: str) -> None:
    """Simulate the square with enough iterations and with too few, and show both."""
    with tempfile.TemporaryDirectory() as scratch:
        runs = [str(Path(scratch, name)) for name in ("square", "too_few_iterations")]
        for run, most in zip(runs, (400, 30), strict=True):
            limit = ["--config", "agile", "--set", f"mpc.advanced.solver.max_iterations={most}"]
            main(["simulate", "--start", "reference", *limit, "--duration", "8", "--out", run])
        for picture, of in {"report.png": runs, "report_in_words.png": runs[1:]}.items():
            page = Path(scratch, f"{picture}.html")
            main(["report", *of, "--out", str(page)])
            _photograph(page, chromium, picture)


def _photograph(page_path: Path, chromium: str, picture: str) -> None:
    """Write the top of the page and some of its sections, one below the other."""
    kept = ", ".join(f"section#{key}" for key in SHOWN[picture])
    hidden = f"body > :not(header, {kept}) {{ display: none; }}"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(WEBGL))
        page = browser.new_page(viewport={"width": 1000, "height": 800})
        page.goto(page_path.as_uri())
        page.add_style_tag(content=hidden)
        page.wait_for_timeout(1000)
        page.screenshot(path=str(IMAGES / picture), full_page=True)
        browser.close()


if __name__ == "__main__":
    update(*sys.argv[1:])
