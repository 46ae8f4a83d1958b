"""What `wyner design` tells besides the sets: why no key is agreed, and what would change it."""
