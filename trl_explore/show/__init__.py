"""Pictures that move: films of agents, and the map of the mixtures as a page."""
