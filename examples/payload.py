"""Weigh what a robot carries: two recordings on one plate, without the load and with it."""

import testbed as tb

quick = ["motion.duration=10", "motion.candidates=3"]
loaded = tb.Experiment.load(tb.shipped("payload"), quick)
empty = tb.Experiment.load(tb.shipped("payload"), [*quick, "simulation.effect=[]", "expect={}"])
tree = tb.load_tree(tb.shipped("puma562.xml"))

before, after = (tb.identify(tree, tb.record(each), "external") for each in (empty, loaded))
found = tb.payload(tree, before, after)

print(f"on the link that {found.joint} moves; in truth 1 kg, 0.43 m along z")
for name, value, sigma, alone in zip(
    found.names, found.values, found.sigma, found.identifiable, strict=True
):
    print(f"{name:6s} {value:9.5f} +- {sigma:.5f}" if alone else f"{name:6s} in combination only")
print("centre [m]:", (found.values[1:4] / found.values[0]).round(4))
for line in tb.sentences(found.diagnostics):
    print(line)
