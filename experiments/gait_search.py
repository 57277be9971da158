"""Search for a gait that rolls, as `jaxgrity search` does."""

from jaxgrity.cli.script import run

from jaxgrity.cli.search import SearchSettings, main

if __name__ == "__main__":
    run(main, SearchSettings)
