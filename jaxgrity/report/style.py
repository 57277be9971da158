"""The style of figures: colours with a meaning, and Matplotlib's settings."""

from pathlib import Path

from matplotlib import style

STRUT, CABLE, GROUND, PATH = "#c1272d", "#444444", "#d9d4c7", "#0b5fa5"
"""Colours of parts: struts are red and cables dark, as in the paper."""
SLACK, FORCE, SUPPORT = "#b9c6d2", "#e69f00", "#009e73"
"""Colours of slack cables, of forces of the ground, and of the polygon of the nodes that touch it."""
WIDTH = 8.0
"""Width of figures, inches: a page of the docs shows 736 pixels, on which letters of 10 points are 13 pixels high."""
MARKERS = "os^Dv<>P"
"""Markers of curves, in the order of the colours: curves differ by both."""
TENSION = "viridis"
"""Matplotlib's colour map of tensions, from none to the largest: its lightness rises, for all eyes."""
SHEET = Path(__file__).with_name("jaxgrity.mplstyle")
"""Matplotlib style sheet of all figures."""

styled = style.context(SHEET)
"""Decorator: what is drawn within the function has the package's style; Matplotlib's own settings stay as they are."""
