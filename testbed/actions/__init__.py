"""Actions: what a trial does with the object, and the path of the tool that does it. A new action is listed here."""

from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action, TableAction, action_from_dict
from testbed.actions.lift import Lift
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh

__all__ = ["Accelerate", "Action", "Lift", "Push", "Rotate", "Slide", "TableAction", "Weigh", "action_from_dict"]
