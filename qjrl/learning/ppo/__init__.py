"""PPO for any environment of pure functions: asymmetric actor and critic, resumable; an iteration is compiled programs."""
