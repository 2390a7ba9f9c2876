"""Choice of actions: the paper's rank-driven policy, plans made before the first trial, and the online policy."""

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import Belief, Criterion, Design, Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import Decision, OnlinePolicy
from estimators.action_selection.plan import Feasible, Goal, Plan, PlanStep
from estimators.action_selection.rank import RankDriven

__all__ = [
    "ActionFamily",
    "Belief",
    "Criterion",
    "Decision",
    "Design",
    "Feasible",
    "Goal",
    "Guess",
    "OnlinePolicy",
    "Plan",
    "PlanStep",
    "PlannedPolicy",
    "RankDriven",
    "RobotTime",
]
