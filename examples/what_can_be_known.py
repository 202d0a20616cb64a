"""What can be known about a robot before any data: python examples/what_can_be_known.py MODEL."""

import sys

import testbed as tb

tree = tb.load_tree(sys.argv[1] if len(sys.argv) > 1 else "models/puma562.urdf")
dynamic = tb.minimal_set(tree, "dynamic")
reaction = tb.minimal_set(tree, "reaction")
print(f"{tree.name}: {10 * tree.n} parameters")
print(f"joint torques tell {dynamic.count}: {', '.join(dynamic.names)}")
only = [name for name in reaction.names if name not in dynamic.names]
print(f"the bedplate tells {reaction.count}, besides: {', '.join(only)}")
