"""The explorer: a page whose sliders change a robot, its gait and its ground, and that shows the motion at once."""
