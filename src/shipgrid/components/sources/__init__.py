"""What gives electric power: batteries and synchronous generators."""
