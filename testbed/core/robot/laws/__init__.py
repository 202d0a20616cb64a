"""Laws of joints' torques, one a module; `testbed.core.robot.friction` finds them."""

from __future__ import annotations
