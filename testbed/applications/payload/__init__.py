"""Mass, centre of mass and inertia of a payload or a tool.

In: recordings without and with the payload, or static poses.
Out: `PayloadEstimate`, and text for robot controllers.
"""
