"""The parts of a search, for studies of one's own.

`pipeline.search_gaits` is where to begin reading: make the problem (`problem`, `search_config`, `search_space`,
`genome`), evolve on each level (`fidelity`, `genetic_algorithm`, `judging`), choose among the best (`promotion`),
polish (`polish`, `climb`, `gradients`), verify (`fidelity.final_verdict`). Two searches of their own find many gaits:
`pareto` and `repertoires`.
"""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
