"""Watch a six-strut robot roll in the browser."""

import webbrowser

from jaxgrity.cli import simulate
from jaxgrity.cli.settings import DemoSettings, SimulateSettings


def main(settings: DemoSettings) -> None:
    """Simulate a gait of the library, open its replay, and propose the next command."""
    chosen = SimulateSettings("exact", gait="straight", diagnose=False, out=settings.out, quick=settings.quick)
    simulate.main(chosen)
    page = settings.out / "replay.html"
    if settings.browser and page.exists():
        shown = webbrowser.open(page.resolve().as_uri())
        print("the page opens in your browser" if shown else f"no browser opens here; the page is {page.resolve()}")
    print("next: `jaxgrity explore` has sliders, and `jaxgrity search --quick` finds a gait; docs/getting_started.md")
