"""What the axis does: recordings, effects, the chain, its MJCF, the ODE and MuJoCo runners."""
