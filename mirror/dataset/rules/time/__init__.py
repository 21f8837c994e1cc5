"""TIM: stamps of pictures, frames and drives."""
