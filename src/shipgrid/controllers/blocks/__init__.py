"""Small kernels that controllers call: PI, low-pass, limiter, ramp, PLL."""
