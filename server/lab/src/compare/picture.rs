//! Pictures of a report, encoded as PNG.

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use ghostlight::frame::ColorImage;
use ghostlight::replay::png_of;

/// A picture with a caption.
#[derive(Debug, Clone, Serialize)]
pub struct Picture {
    pub(super) caption: String,
    pub(super) width: u32,
    pub(super) height: u32,
    #[serde(skip)]
    pub(super) png: Vec<u8>,
}

/// A rectangle of pixels; x1 and y1 are exclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Column after the last.
    pub x1: u32,
    /// Row after the last.
    pub y1: u32,
}

impl Picture {
    /// An image, or a window of it.
    pub fn new(
        caption: impl Into<String>,
        image: &ColorImage,
        window: Option<Window>,
    ) -> Result<Self> {
        let caption = caption.into();
        let image = window.map_or_else(|| image.clone(), |window| window.of(image));
        let png = png_of(&image).with_context(|| caption.clone())?;
        Ok(Self {
            caption,
            width: image.width,
            height: image.height,
            png,
        })
    }

    /// The difference of two images, times `gain`: white where they are equal, red where the first is brighter,
    /// blue where the second is.
    pub fn difference(
        caption: impl Into<String>,
        [a, b]: [&ColorImage; 2],
        gain: f32,
        window: Option<Window>,
    ) -> Result<Self> {
        ensure!(
            (a.width, a.height) == (b.width, b.height),
            "pictures to compare: expected one size, got {}x{} and {}x{}",
            a.width,
            a.height,
            b.width,
            b.height
        );
        let gray = |p: &[u8; 4]| {
            f32::from(p[0]) * 0.2126 + f32::from(p[1]) * 0.7152 + f32::from(p[2]) * 0.0722
        };
        let rgba = a
            .rgba
            .iter()
            .zip(&b.rgba)
            .map(|(p, q)| {
                let d = (gray(p) - gray(q)) * gain;
                let fade = (255.0 - d.abs()).clamp(0.0, 255.0) as u8;
                if d > 0.0 {
                    [255, fade, fade, 255]
                } else {
                    [fade, fade, 255, 255]
                }
            })
            .collect();
        let image = ColorImage {
            width: a.width,
            height: a.height,
            rgba,
        };
        Self::new(caption, &image, window)
    }
}

impl Window {
    /// The smallest window with all pixels that differ between two images of one size, plus `margin` pixels;
    /// `None` if the images are equal.
    pub fn of_difference(a: &ColorImage, b: &ColorImage, margin: u32) -> Option<Self> {
        let mut found: Option<Self> = None;
        for (i, _) in (0u32..)
            .zip(a.rgba.iter().zip(&b.rgba))
            .filter(|(_, (p, q))| p != q)
        {
            let (x, y) = (i % a.width, i / a.width);
            let window = found.get_or_insert(Self {
                x0: x,
                y0: y,
                x1: x + 1,
                y1: y + 1,
            });
            window.x0 = window.x0.min(x);
            window.x1 = window.x1.max(x + 1);
            window.y1 = y + 1;
        }
        found.map(|w| Self {
            x0: w.x0.saturating_sub(margin),
            y0: w.y0.saturating_sub(margin),
            x1: (w.x1 + margin).min(a.width),
            y1: (w.y1 + margin).min(a.height),
        })
    }

    fn of(self, image: &ColorImage) -> ColorImage {
        let (x0, x1) = (self.x0.min(image.width), self.x1.min(image.width));
        let (y0, y1) = (self.y0.min(image.height), self.y1.min(image.height));
        let row = |y: u32| {
            let start = (y * image.width) as usize;
            &image.rgba[start + x0 as usize..start + x1.max(x0) as usize]
        };
        ColorImage {
            width: x1.saturating_sub(x0),
            height: y1.saturating_sub(y0),
            rgba: (y0..y1).flat_map(row).copied().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_holds_every_difference() {
        let a = ColorImage::filled(10, 8, [9; 4]);
        let mut b = a.clone();
        assert_eq!(Window::of_difference(&a, &b, 3), None);
        b.rgba[2 * 10 + 4] = [0; 4];
        b.rgba[5 * 10 + 1] = [0; 4];
        let window = Window::of_difference(&a, &b, 0).unwrap();
        assert_eq!(
            window,
            Window {
                x0: 1,
                y0: 2,
                x1: 5,
                y1: 6
            }
        );
        let cut = window.of(&b);
        assert_eq!((cut.width, cut.height, cut.rgba.len()), (4, 4, 16));
        assert_eq!(cut.rgba[3], [0; 4]);
        let wide = Window::of_difference(&a, &b, 3).unwrap();
        assert_eq!(
            wide,
            Window {
                x0: 0,
                y0: 0,
                x1: 8,
                y1: 8
            }
        );
    }

    #[test]
    fn a_difference_says_which_is_brighter() {
        let a = ColorImage::filled(1, 1, [100, 100, 100, 255]);
        let b = ColorImage::filled(1, 1, [90, 90, 90, 255]);
        let png = Picture::difference("", [&a, &b], 10.0, None).unwrap().png;
        let pixel = image::load_from_memory(&png).unwrap().to_rgba8();
        assert_eq!(pixel.get_pixel(0, 0).0, [255, 155, 155, 255]);
        assert!(
            Picture::difference("", [&a, &ColorImage::filled(2, 1, [0; 4])], 1.0, None).is_err()
        );
    }
}
