"""The conformance kit: what every estimator must do, and known blocks to recover from recorded trials. No simulator.

    pytest --pyargs estimators.testing --estimator package:Class

The pytest plugin gives other tests the fixtures `known_block`, `sensing` and `recorded_trials`.
"""
