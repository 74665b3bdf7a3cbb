"""Drake systems between a glove and a robot, and what they read from a plant."""
