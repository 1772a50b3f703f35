"""What drives a switch: answers to "what is s during this step?"."""
