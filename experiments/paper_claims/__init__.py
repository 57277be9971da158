"""The claims of the paper that the project began from, each measured and judged by what was measured."""
