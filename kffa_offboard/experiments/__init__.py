"""The paper's simulation section, reproduced: plant of eq 15, Examples 1-4, figures, verdicts."""
