"""``make gpu-check``: what gsplat and the whole system do on this machine's GPU, in eight minutes at most."""
