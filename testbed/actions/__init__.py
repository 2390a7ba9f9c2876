"""Actions: motions of the object in a trial, and the paths of the tool. A new action is listed here."""

from testbed.actions import accelerate, lift, push, rotate, slide, weigh

__all__ = ["accelerate", "lift", "push", "rotate", "slide", "weigh"]
