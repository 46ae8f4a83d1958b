"""``wyner design --alphas``: how many bits the paper's rule allows, at what price."""
