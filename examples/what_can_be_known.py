"""The base parameters of a robot, before any data: python examples/what_can_be_known.py [MODEL]."""

import sys

import testbed as tb

tree = tb.load_tree(sys.argv[1] if len(sys.argv) > 1 else tb.shipped("puma562.urdf"))
print(tree)
dynamic = tb.minimal_set(tree, "torque")  # delta_d, by joint torques
reaction = tb.minimal_set(tree, "wrench")  # delta_r, by the bedplate's reaction

print(f"Of {10 * tree.n} inertial parameters")
print(f"joint torques identify {dynamic.count}: {', '.join(dynamic.names)}")
only = [name for name in reaction.names if name not in dynamic.names]
print(f"the force plate identifies {reaction.count}, these and: {', '.join(only)}")

print("Those that stand for several parameters of the links:")
for formula in reaction.formulas:
    print(" ", formula)

values = reaction.values(tb.barycentric(tree))  # by the model file's own masses
for name, value, unit in zip(reaction.names, values, reaction.units, strict=True):
    print(f"{name:10s} {value:10.5f} {unit}")
