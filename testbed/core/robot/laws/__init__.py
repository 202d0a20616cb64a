"""Additional joint torque laws, one module each, collected by `testbed.core.robot.friction`."""

from __future__ import annotations
