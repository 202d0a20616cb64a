"""A payload's or a tool's mass, centre and inertia.

In: recordings without it and with it, or poses at rest.
Out: `Payload`, and its form for controllers.
"""
