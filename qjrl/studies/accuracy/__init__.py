"""How near controllers come to targets: open loop and with measurements, with slack strands, out of reach."""
