"""Roll a scene out, as `jaxgrity simulate` does."""

from jaxgrity.cli.script import run

from jaxgrity.cli.simulate import SimulateSettings, main

if __name__ == "__main__":
    run(main, SimulateSettings)
