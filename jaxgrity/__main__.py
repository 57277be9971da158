"""`python -m jaxgrity` is the command `jaxgrity`."""

from jaxgrity.cli.main import main

if __name__ == "__main__":
    main()
