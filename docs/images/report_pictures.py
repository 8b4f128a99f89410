"""The pictures of docs/report.md, of the released results: ``glbench report`` first, then this. Needs chromium and Pillow.

``python docs/images/report_pictures.py reports/index.html``

The picture of a day of energy is of another page: a report of the third set of rules of docs/energy.md, evaluated as the agent `engine`.

``python docs/images/report_pictures.py --energy /tmp/try/index.html``

So is that of a story: ``glbench evaluate submissions/my_agent.py rule_based_tuned --split validation --runs 3 --out /tmp/try``, then
``glbench story /tmp/try/validation/results/GreenhouseReal-v1/my_agent.json --page /tmp/try/story.html``.

``python docs/images/report_pictures.py --story /tmp/try/story.html``
"""

import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, sync_playwright

TASK = "GreenhouseReal-v1"
Picture = tuple[str, tuple[int, int], str, int | str]
PICTURES: dict[str, Picture] = {
    "report-leaderboard": (f"#/{TASK}", (1250, 1340), "light", 0),
    "report-overall": ("#/overall", (1250, 1320), "light", "#profiles"),
    "report-compare": (f"#/compare/mpc_greenhouse/rule_based_greenhouse/{TASK}", (1250, 700), "light", "#hours"),
    "report-phone": (f"#/agent/ppo_memory_greenhouse/{TASK}", (390, 1000), "dark", 0),
}
"""Name, view, size in pixels, colours, and how far down it is scrolled, or to which element."""
OF_ENERGY: dict[str, Picture] = {"report-energy": ("#/agent/engine/Energy-v1", (1250, 1190), "light", "#energy")}
OF_STORY: dict[str, Picture] = {"report-story": ("", (1250, 1330), "light", 0)}
IN_VIEW = """[...document.querySelectorAll('.chart')].filter((one) => {
    const { top, bottom } = one.getBoundingClientRect();
    return one.checkVisibility() && top < innerHeight && bottom > 0;
}).every((one) => one.dataset.drawn === 'yes')"""
SCROLL = """(down) => {
    const top = Number.isFinite(down) ? down : document.querySelector(down).getBoundingClientRect().top - 80;
    scrollTo({ top, behavior: 'instant' });
}"""


def take(browser: Browser, page_file: str, name: str, picture: Picture) -> None:
    """Take one picture of a page."""
    view, (width, height), colours, down = picture
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=colours)
    page.goto(page_file + view)
    page.wait_for_function("document.querySelector('h1') && !document.querySelector('[aria-busy]')")
    page.evaluate(SCROLL, down)
    page.wait_for_timeout(1_000)
    page.wait_for_function(IN_VIEW, timeout=120_000)
    file = Path(__file__).with_name(f"{name}.png")
    page.screenshot(path=file)
    with Image.open(file) as taken:  # flat colours: a palette says the same in a third of the bytes
        taken.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE).save(file, optimize=True)


if __name__ == "__main__":
    pictures = OF_ENERGY if "--energy" in sys.argv else OF_STORY if "--story" in sys.argv else PICTURES
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for one, how in pictures.items():
            take(chromium, Path(sys.argv[-1]).resolve().as_uri(), one, how)
        chromium.close()
