"""A study: the experiments of a scenario, their trials and estimates."""
