"""Plausibility checks of recordings against a robot model, and mappings solved from data.

In: a `Tree` and a `Source`. Out: diagnostics with causes, and mappings that correct them.
"""
