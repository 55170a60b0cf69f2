//! The picture of the mechanism, from `modelDescription/model.svg`.

use crate::paths;
use anyhow::{Context, Result};
use resvg::{tiny_skia, usvg};
use std::fs;

const SOURCE: &str = "modelDescription/model.svg";

/// The picture as SVG text.
pub(super) fn picture() -> Result<String> {
    fs::read_to_string(paths::in_root(SOURCE)).with_context(|| format!("{SOURCE} cannot be read"))
}

/// The picture as PNG, at the size stated in the SVG.
pub(super) fn render(svg: &str) -> Result<Vec<u8>> {
    let tree = usvg::Tree::from_str(svg, &usvg::Options::default()).with_context(|| format!("{SOURCE} cannot be drawn"))?;
    let size = tree.size().to_int_size();
    let mut pixels = tiny_skia::Pixmap::new(size.width(), size.height()).with_context(|| format!("{SOURCE} states no size"))?;
    resvg::render(&tree, tiny_skia::Transform::identity(), &mut pixels.as_mut());
    pixels.encode_png().with_context(|| format!("{SOURCE} cannot be written as PNG"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_icon_is_a_picture_that_reaches_into_its_corners_and_has_colours() {
        let png = render(&picture().unwrap()).unwrap();
        let pixels = tiny_skia::Pixmap::decode_png(&png).unwrap();
        assert!(pixels.width() >= 300 && pixels.height() >= 200);
        let colours: std::collections::HashSet<_> =
            pixels.pixels().iter().map(|pixel| (pixel.red(), pixel.green(), pixel.blue())).collect();
        assert!(colours.len() > 50, "only {} colours", colours.len());
    }
}
