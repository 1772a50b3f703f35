"""Plant items: components and controllers wired once, with commands, on/off sequence and public signals."""
