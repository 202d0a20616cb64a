"""Plausibility checks of recordings against a robot model, and mappings solved from data.

Input: a `Tree` and a `Source`.
Output: diagnostics with causes, and mappings that correct them.
"""
