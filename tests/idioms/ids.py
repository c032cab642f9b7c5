"""The ids that stand where the other projects' documentation has ``CartPole-v1`` and the like."""

SIM = "wrongturn_sim:WrongturnSim-v0"
FLAT = "wrongturn_sim:WrongturnSimFlat-v0"
DISCRETE = "wrongturn_sim:WrongturnSimFlatDiscrete-v0"
PIXELS = "wrongturn_sim:WrongturnSimPixels-v0"
WIRE_FLAT = "wrongturn_client:WrongturnFlat-v0"
