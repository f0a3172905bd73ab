"""The command line: ``trl-explore train|report|status|time``."""
