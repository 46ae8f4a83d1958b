"""How many bits the paper's rule allows, at what price."""
