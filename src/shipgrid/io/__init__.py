"""The world outside, as files: ship and scenario files, quantities, reports, pictures."""
