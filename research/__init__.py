"""What answered a question of ours once: it imports the public API and reads run directories."""
