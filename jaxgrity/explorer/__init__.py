"""The explorer: a page with sliders for a robot, its gait and its ground, and the motion at once."""
