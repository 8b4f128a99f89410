"""The pictures of docs/report.md, of the released results: ``glbench report`` first, then this. Needs chromium and Pillow.

``python docs/images/report_pictures.py reports/index.html``
"""

import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

TASK = "Schiphol2010-Delta10-v1"
PICTURES = {
    "report-leaderboard": (f"#/{TASK}", (1250, 1340), "light", 0),
    "report-overall": ("#/overall", (1250, 960), "light", 1910),
    "report-compare": (f"#/compare/ppo/rule_based/{TASK}", (1250, 790), "light", 1040),
    "report-phone": (f"#/agent/ppo/{TASK}", (390, 1000), "dark", 0),
}
"""Name, view, size in pixels, colours, and how far down it is scrolled."""
IN_VIEW = """[...document.querySelectorAll('.chart')].filter((one) => {
    const { top, bottom, height } = one.getBoundingClientRect();
    return height > 0 && top < innerHeight && bottom > 0;
}).every((one) => one.dataset.drawn === 'yes')"""

page_file = Path(sys.argv[1]).resolve().as_uri()
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    for name, (view, (width, height), colours, down) in PICTURES.items():
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=colours)
        page.goto(page_file + view)
        page.wait_for_function("document.querySelector('h1') && !document.querySelector('[aria-busy]')")
        page.evaluate("(down) => scrollTo({ top: down, behavior: 'instant' })", down)
        page.wait_for_timeout(1_000)
        page.wait_for_function(IN_VIEW, timeout=120_000)
        file = Path(__file__).with_name(f"{name}.png")
        page.screenshot(path=file)
        with Image.open(file) as picture:  # flat colours: a palette says the same in a third of the bytes
            picture.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
                file, optimize=True
            )
    browser.close()
