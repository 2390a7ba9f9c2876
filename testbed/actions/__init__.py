"""Actions: what a trial does with the object, and the path of the tool that does it. A new action is listed here."""

from testbed.actions import accelerate, lift, push, rotate, slide, weigh

__all__ = ["accelerate", "lift", "push", "rotate", "slide", "weigh"]
