"""A URDF with the result: physically consistent bodies, friction, all else byte for byte."""

import sys

import testbed as tb

robot = tb.load_tree("puma562.urdf")
rig = tb.Rig(robot, sensors=[tb.ForcePlate(noise=(0.5, 0.1)), tb.JointTorques(noise=0.5)])
data = tb.simulate(rig, tb.random_motion(robot, seed=1), seconds=10)

both = tb.identify(robot, data, "wrench") + tb.identify(robot, data, "torque")
real = both + tb.prior(robot)  # the file's values stay where the data do not determine them
print("least eigenvalues, all positive:", real.bodies.eigenvalues[:, 0].round(3))
print(real)

path = sys.argv[1] if len(sys.argv) > 1 else "identified.urdf"
for each in tb.write_model(real, path):
    print(each)
print("written:", path)
