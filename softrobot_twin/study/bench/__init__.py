"""What a step costs, stage by stage, over sizes and over contacts."""
