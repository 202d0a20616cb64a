"""Bodies and joints without names are told apart all the same."""

from __future__ import annotations

from pathlib import Path

import testbed as tb

BODY = '<body{}><joint type="hinge"/><geom size="0.1" mass="1" pos="{} 0 0"/>'


def test_no_name_is_given_twice(tmp_path: Path) -> None:
    """Where the name that a body would have is another's already, too."""
    names = ["", "", ' name="body1"', ' name="body3"', ""]
    chain = "".join(BODY.format(name, k + 1) for k, name in enumerate(names))
    text = f"<mujoco><worldbody>{chain}{'</body>' * len(names)}</worldbody></mujoco>"
    (tmp_path / "chain.xml").write_text(text)
    tree = tb.load_tree(tmp_path / "chain.xml")
    bodies = [joint.body for joint in tree.joints]
    assert len(set(tree.names)) == len(set(bodies)) == len(names)
    assert {"body1", "body3"} < set(bodies)
