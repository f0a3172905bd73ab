"""Training: the trainer, the record of every trial, evaluation, diagnostics and optimisers."""
