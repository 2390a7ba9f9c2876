"""Planning as an environment of Gymnasium, and the training of a policy in it. Needs the extra `gym`.

The import registers `heft/Planning-v0`; `gymnasium.make("scenarios.environment:heft/Planning-v0")` does both.
"""

from testbed.errors import HeftError

try:
    import gymnasium
except ImportError:
    raise HeftError(
        "the environment needs Gymnasium, which is not installed: pip install 'heft-testbed[gym]'"
    ) from None

from scenarios.environment.planning import PlanningEnv

__all__ = ["PlanningEnv"]

gymnasium.register("heft/Planning-v0", entry_point="scenarios.environment.planning:PlanningEnv")
