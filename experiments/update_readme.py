"""Write the README's measured numbers, and its pictures, from the results that the scripts left."""

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from common import run

from jaxgrity.files import save_json, write_whole
from jaxgrity.structure import InputError

ROOT = Path(__file__).parents[1]
PICTURES = {"gait_search": ("animation.gif", "rolling.gif"), "throughput": ("throughput.png", "throughput.png")}


@dataclass
class Settings:
    results: Path = Path("results")
    """folder in which gait_search.py and throughput.py left their results"""
    quick: bool = False
    """it is quick already"""


def main(settings: Settings) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, sentence in (("gait_search", gait_search), ("throughput", throughput)):
        source = settings.results / name / "summary.json"
        if not source.exists():
            raise InputError(f"{source}: not there; expected experiments/{name}.py to have been run")
        facts = json.loads(source.read_text())
        save_json(ROOT / "docs" / "measured" / f"{name}.json", facts)
        picture, target = PICTURES[name]
        shutil.copyfile(settings.results / name / picture, ROOT / "docs" / "images" / target)
        text = fill(text, name, sentence(facts))
    write_whole(ROOT / "README.md", lambda file: file.write(text.encode()))
    print("wrote README.md, docs/measured/ and docs/images/")


def fill(text: str, name: str, words: str) -> str:
    """`text` with what stands between the marks of `name` replaced."""
    marks = re.compile(rf"(<!-- measured: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    return marks.sub(lambda match: f"{match[1]}{words}\n{match[2]}", text)


def gait_search(facts: dict) -> str:
    polish, search = facts["polish"], facts["search"]
    gain = "which improved it" if polish["improved"] else "which found nothing better"
    steps = f"{len(polish['gradient_norm'])} gradient steps over {polish['horizon']:.1f} s"
    return (
        f"`make gait` ({facts['wall_seconds']:.0f} s on 2 cores; `experiments/gait_search.py`) found a gait that "
        f"travels **{facts['distance']:.3f} ± {facts['error_bar']:.1g} m** in {facts['settings']['duration']:g} s, "
        f"after {search['rollouts']} rollouts and {steps}, {gain}. "
        f"Its sensitivity at the end is {facts['diagnosis']['sensitivity']:.0f} m per radian of phase "
        "([docs/measured/gait_search.json](docs/measured/gait_search.json))."
    )


def throughput(facts: dict) -> str:
    single, double, gradient = facts["rk4"]["float32"], facts["rk4"]["float64"], facts["gradient"]
    return (
        "One RK4 step of one gait of the reference scene, every term of it, takes "
        f"{single['us']:.2f} us in float32 and "
        f"{double['us']:.2f} us in float64 ({facts['gaits']} gaits, {facts['devices']} cores, median of "
        f"{facts['repeats']}): {single['ratio']:.1f} and {double['ratio']:.1f} times hand-written "
        "SIMD C in the same run, with which the final "
        f"centres of mass agree to {double['largest_difference']:.0e} m in float64. The gradient of the distance in "
        f"{gradient['phases']} phases costs {gradient['reverse']:.1f} rollouts by reverse mode with a checkpointed "
        f"step, and {gradient['forward']:.1f} by forward mode; polishing uses the first "
        "(`experiments/throughput.py --limit FOLDER`, [docs/measured/throughput.json](docs/measured/throughput.json))."
    )


if __name__ == "__main__":
    run(main, Settings)
