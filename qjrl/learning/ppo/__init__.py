"""PPO for any vector environment: asymmetric actor and critic, resumable, stepped from the host."""
