#!/bin/sh
# The whole example; run it in a copy of this folder, because sensor.toml is corrected in place.
set -e
stillcal simulate motion.toml --phone real.toml --seed 7 --out real.csv     # stands for your recording
python play.py sensor.toml mujoco.csv                                       # your simulator
stillcal diagnose real.csv --simulated mujoco.csv --fix-for phone sensor.toml
python play.py sensor.toml mujoco.csv                                       # once more, corrected
stillcal diagnose real.csv --simulated mujoco.csv --fail-on identified --fail-on partly_identified
