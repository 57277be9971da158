"""List the structures of the catalogue, each with its keys in a scene file and a picture."""

from typing import Any, get_args

from jaxgrity.cli.settings import CatalogueSettings
from jaxgrity.core.display import aligned
from jaxgrity.io.files import save_json
from jaxgrity.io.structure_tables import CatalogueTable, RobotTable
from jaxgrity.report import plot
from jaxgrity.structures.geometry import RobotGeometry


def main(settings: CatalogueSettings) -> None:
    """Print the kinds, and write them as JSON with pictures."""
    entries, structures = [], {}
    for table in get_args(CatalogueTable | RobotTable):
        kind, example = table.__struct_config__.tag, table()
        geometry = RobotGeometry(*example.geometry())
        entries.append(entry(kind, example.own_keys(), geometry))
        structures[kind] = geometry
    if not settings.quick:
        for kind, geometry in structures.items():
            plot.save(plot.geometry_figure({kind: geometry}), settings.out / f"{kind}.png")
        plot.save(plot.geometry_figure(structures), settings.out / "catalogue.png")
    print(listed(entries))
    save_json(settings.out / "catalogue.json", {"structures": entries})
    print(f"wrote {settings.out}/")


def entry(kind: str, keys: dict[str, Any], geometry: RobotGeometry) -> dict[str, Any]:
    """The entry of one kind: its keys with their defaults, and its size with them."""
    return {
        "kind": kind,
        "keys": keys,
        "nodes": len(geometry.nodes),
        "struts": len(geometry.struts),
        "cables": len(geometry.cables),
        "bodies": len(geometry.bodies),
    }


def listed(entries: list[dict[str, Any]]) -> str:
    """The list: a line for each kind."""
    counts = ("nodes", "struts", "cables", "bodies")
    rows = [["kind", *counts, "keys of [structure], with their defaults"]]
    for found in entries:
        keys = ", ".join(f"{key} = {'-' if value is None else value}" for key, value in found["keys"].items())
        rows.append([*(str(found[name]) for name in ("kind", *counts)), keys])
    return aligned(rows)
