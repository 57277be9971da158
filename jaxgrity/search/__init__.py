"""The parts of a search, for studies of one's own.

`pipeline.search_gaits` is where to begin reading: evolve on each level (`fidelity`, `genetic_algorithm`, `judging`),
choose among the best (`promotion`), polish (`polish`, `climb`, `gradients`), verify (`fidelity.final_verdict`).
"""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
