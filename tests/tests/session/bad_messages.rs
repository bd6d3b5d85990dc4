//! Messages that a server must refuse in a session whose frames are 32x24.

use ghostlight_proto::{Code, Codec, Frame};

use super::client::frame;

/// A message to send.
pub(crate) enum Bad {
    Bytes(Vec<u8>),
    Text(String),
}

/// A frame with the given payloads.
fn with(color_codec: Codec, color: &[u8], depth_codec: Codec, depth: &[u8]) -> Bad {
    let raw = frame(1, 1);
    let plain = Frame::decode(&raw).unwrap();
    let mut header = plain.header;
    (header.color_codec, header.depth_codec) = (color_codec, depth_codec);
    let color = if color.is_empty() { plain.color } else { color };
    let depth = if depth.is_empty() { plain.depth } else { depth };
    Bad::Bytes(
        Frame {
            header,
            color,
            depth,
        }
        .encode()
        .unwrap(),
    )
}

fn picture(width: u32, height: u32, format: image::ImageFormat) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height)
        .write_to(&mut out, format)
        .unwrap();
    out.into_inner()
}

/// A depth PNG of zeros.
fn deep(width: u32, height: u32) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(width, height)
        .write_to(&mut out, image::ImageFormat::Png)
        .unwrap();
    out.into_inner()
}

/// Each bad message: its name, the code of its error, and the message.
pub(crate) fn cases() -> Vec<(&'static str, Code, Bad)> {
    let put = |offset: usize, value: &[u8]| {
        let mut bytes = frame(1, 1);
        bytes[offset..offset + value.len()].copy_from_slice(value);
        Bad::Bytes(bytes)
    };
    let text = |text: &str| Bad::Text(text.to_owned());
    let good = frame(1, 1);
    let jpeg = picture(32, 24, image::ImageFormat::Jpeg);
    let png = picture(32, 24, image::ImageFormat::Png);
    let mut corrupt = png.clone();
    corrupt[60] ^= 0xFF;
    // 26 MB of zeros in 26 KB.
    let bomb = picture(3000, 3000, image::ImageFormat::Png);
    let zeros = ghostlight_proto::depth::encode_delta_zstd(&vec![0; 8 << 20]).unwrap();
    let rvl = ghostlight_proto::depth::encode_rvl(&vec![7; 32 * 24]);
    let zstd = ghostlight_proto::depth::encode_delta_zstd(&vec![7; 32 * 24]).unwrap();
    // A picture whose frame header says that it is 65500 pixels wide and high.
    let mut huge = jpeg.clone();
    let frame_header = huge.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    huge[frame_header + 5..frame_header + 9].copy_from_slice(&[0xFF, 0xDC, 0xFF, 0xDC]);
    vec![
        ("empty", Code::Malformed, Bad::Bytes(vec![])),
        ("garbage", Code::Malformed, Bad::Bytes(vec![7; 300])),
        (
            "truncated header",
            Code::Malformed,
            Bad::Bytes(good[..100].to_vec()),
        ),
        (
            "truncated payload",
            Code::Length,
            Bad::Bytes(good[..good.len() - 9].to_vec()),
        ),
        (
            "trailing bytes",
            Code::Length,
            Bad::Bytes([&good[..], b"x"].concat()),
        ),
        ("version", Code::Version, put(2, &[9])),
        ("kind", Code::UnknownType, put(3, &[77])),
        ("a composite", Code::UnknownType, put(3, &[2])),
        ("NaN pose", Code::Pose, put(32, &f64::NAN.to_le_bytes())),
        ("not a rotation", Code::Pose, put(48, &3f64.to_le_bytes())),
        (
            "NaN extrinsics",
            Code::Pose,
            put(160, &f64::NAN.to_le_bytes()),
        ),
        ("zero fx", Code::Intrinsics, put(88, &0f64.to_le_bytes())),
        (
            "negative fy",
            Code::Intrinsics,
            put(96, &(-1f64).to_le_bytes()),
        ),
        (
            "NaN cx",
            Code::Intrinsics,
            put(104, &f64::NAN.to_le_bytes()),
        ),
        (
            "zero depth fx",
            Code::Intrinsics,
            put(128, &0f64.to_le_bytes()),
        ),
        (
            "infinite depth cy",
            Code::Intrinsics,
            put(152, &f64::INFINITY.to_le_bytes()),
        ),
        (
            "zero metres per unit",
            Code::Intrinsics,
            put(216, &0f64.to_le_bytes()),
        ),
        (
            "NaN largest depth",
            Code::Intrinsics,
            put(236, &f32::NAN.to_le_bytes()),
        ),
        ("zero width", Code::Size, put(80, &0u32.to_le_bytes())),
        ("other size", Code::Size, put(80, &33u32.to_le_bytes())),
        ("colour codec", Code::Codec, put(224, &[18])),
        ("depth codec", Code::Codec, put(225, &[1])),
        (
            "no JPEG",
            Code::Decode,
            with(Codec::Jpeg, b"not a JPEG", Codec::U16, b""),
        ),
        (
            "cut JPEG",
            Code::Decode,
            with(Codec::Jpeg, &jpeg[..jpeg.len() / 2], Codec::U16, b""),
        ),
        (
            "PNG as JPEG",
            Code::Decode,
            with(Codec::Jpeg, &png, Codec::U16, b""),
        ),
        (
            "corrupt PNG",
            Code::Decode,
            with(Codec::Png, &corrupt, Codec::U16, b""),
        ),
        (
            "PNG bomb",
            Code::Size,
            with(Codec::Png, &bomb, Codec::U16, b""),
        ),
        (
            "JPEG bomb",
            Code::Size,
            with(Codec::Jpeg, &huge, Codec::U16, b""),
        ),
        (
            "JPEG of another size",
            Code::Size,
            with(
                Codec::Jpeg,
                &picture(31, 24, image::ImageFormat::Jpeg),
                Codec::U16,
                b"",
            ),
        ),
        (
            "depth bomb",
            Code::Size,
            with(Codec::Rgb8, b"", Codec::Png, &deep(3000, 3000)),
        ),
        (
            "depth of another size",
            Code::Size,
            with(Codec::Rgb8, b"", Codec::Png, &deep(32, 23)),
        ),
        (
            "cut depth PNG",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Png, &deep(32, 24)[..60]),
        ),
        (
            "depth not grey",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Png, &png),
        ),
        (
            "cut RVL",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Rvl, &rvl[..rvl.len() - 4]),
        ),
        (
            "RVL noise",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Rvl, &[0xFF; 64]),
        ),
        (
            "RVL bomb",
            Code::Decode,
            with(
                Codec::Rgb8,
                b"",
                Codec::Rvl,
                &ghostlight_proto::depth::encode_rvl(&vec![0; 1 << 24]),
            ),
        ),
        (
            "RVL with more behind it",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Rvl, &[&rvl[..], &[0; 4]].concat()),
        ),
        (
            "cut zstd",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::DeltaZstd, &zstd[..zstd.len() - 2]),
        ),
        (
            "zstd with more behind it",
            Code::Decode,
            with(
                Codec::Rgb8,
                b"",
                Codec::DeltaZstd,
                &[&zstd[..], b"x"].concat(),
            ),
        ),
        (
            "zstd noise",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::DeltaZstd, &[0xFF; 64]),
        ),
        (
            "zstd bomb",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::DeltaZstd, &zeros),
        ),
        ("not JSON", Code::Malformed, text("{")),
        ("no object", Code::Malformed, text("3")),
        (
            "unknown type",
            Code::UnknownType,
            text(r#"{"type":"dance"}"#),
        ),
        (
            "second hello",
            Code::Hello,
            text(r#"{"type":"hello","version":1,"role":"viewer"}"#),
        ),
        (
            "settings",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"bounces":1}}"#),
        ),
        (
            "setting's range",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"max_bounces":99}}"#),
        ),
        (
            "setting's kind",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"max_bounces":"a"}}"#),
        ),
        (
            "absent asset",
            Code::Scene,
            text(r#"{"type":"scene","scene":{"mesh":"b.obj"}}"#),
        ),
        (
            "absent scene",
            Code::NotFound,
            text(r#"{"type":"scene","scene":"nowhere"}"#),
        ),
        (
            "absent object",
            Code::Object,
            text(r#"{"type":"turn","object":"cup","angle":1}"#),
        ),
        (
            "no rotation to put an object back to",
            Code::Pose,
            text(
                r#"{"type":"place","object":"thing","stands":{"translation":[0,0,0],"quaternion":[1,1,1,1]}}"#,
            ),
        ),
        (
            "place nowhere",
            Code::Malformed,
            text(r#"{"type":"place","object":"thing"}"#),
        ),
        (
            "planes",
            Code::Codec,
            text(r#"{"type":"planes","depth":"jpeg"}"#),
        ),
        (
            "times",
            Code::Malformed,
            text(r#"{"type":"credit","draw_us":-1}"#),
        ),
        (
            "play on live",
            Code::Forbidden,
            text(r#"{"type":"play","recording":"room"}"#),
        ),
        (
            "large message",
            Code::TooLarge,
            Bad::Bytes(vec![0; 300_000]),
        ),
        (
            "large text",
            Code::TooLarge,
            Bad::Text(format!("[{}]", "1,".repeat(20_000))),
        ),
    ]
}
