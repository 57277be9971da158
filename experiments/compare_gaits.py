"""Compare gait searches, as `jaxgrity compare` does."""

from jaxgrity.cli.script import run

from jaxgrity.cli.compare import CompareSettings, main

if __name__ == "__main__":
    run(main, CompareSettings)
