"""What any tap leaves of the coins, who watches the machine through noise: a bound, and taps."""
