"""People's hands: keypoints, recordings (`formats`, `checks`), a hand model, synthetic people."""
