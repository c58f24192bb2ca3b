//! Small text in single-stroke letters of our own, as architects letter their drawings.

use super::canvas::Brush;
use tiny_skia::{Path, PathBuilder};

/// Height of a capital above the base line, in letter units.
const CAPITAL: f64 = 14.0;
/// Room between letters.
const SPACING: f64 = 4.2;

/// Each letter: its character, its width, then its strokes: `l` a polyline, `s` a smooth curve from the first to the last
/// point, `o` a smooth closed curve. A point is two base-36 digits, x and y; the base line is at y = 4, small letters end at 14
/// (`e`), capitals at 18 (`i`).
const LETTERS: &str = "\
a 8 o04848e0e l8e84
b 8 l0i04 o04848e0e
c 7 s7c7e0e047476
d 8 o04848e0e l8i84
e 8 l0989 s898e0e048486
f 5 s6i2i2c l2c24 l0e5e
g 8 o04848e0e l8e82 s82800002
h 8 l0i04 s090e8e89 l8984
i 0 l0e04 l0h0i
j 2 l2e22 s222000 l2h2i
k 7 l0i04 l7e08 l2a74
l 0 l0i04
m c l0e04 s090e6e69 l6964 s696ecec9 lc9c4
n 8 l0e04 s090e8e89 l8984
o 8 o04848e0e
p 8 l0e00 o04848e0e
q 8 o04848e0e l8e80
r 5 l0e04 s090e5e
s 6 s6c6e0e0969640406
t 5 l2h27 s272454 l0e5e
u 8 l0e09 s09048489 l8e84
v 8 l0e448e
w c l0e346c94ce
x 7 l0e74 l047e
y 8 l0e44 l8e20
z 7 l0e7e0474
A a l045ia4 l1898
B 9 l040i4i s4i9i9b4b l4b0b s4baba444 l4404
C a sagai0i04a4a6
D a l040i4i s4ibib444 l4404
E 8 l8i0i0484 l0b7b
F 8 l8i0i04 l0b7b
G a sagai0i04a4ab lab6b
H a l0i04 laia4 l0bab
I 0 l0i04
J 6 l6i69 s69640407
K 9 l0i04 l9i09 l3c94
L 8 l0i0484
M c l040i6acic4
N a l040ia4ai
O b o04b4bi0i
P 9 l040i4i s4i9i9a4a l4a0a
Q b o04b4bi0i l78b3
R 9 l040i4i s4i9i9a4a l4a0a l4a94
S 8 s8f8i0i0b8b840407
T a l0iai l5i54
U a l0i09 s0904a4a9 la9ai
V a l0i54ai
W e l0i447ea4ei
X a l0ia4 l04ai
Y a l0i5bai l5b54
Z a l0iai04a4
0 8 o04848i0i
1 8 l1f4i44
2 8 s0f0i8i8c04 l0484
3 8 s0g0i8i8b3b s3b8b840406
4 8 l646i0888
5 8 l7i1i1c s1c8e840406
6 8 o04848c0c s7i0i08
7 8 l0i8i24
8 8 o1b7b7i1i o04848b0b
9 8 o0a8a8i0i s8e8414
. 0 l0405
, 1 l1402
: 0 l0405 l0c0d
; 1 l1402 l1c1d
- 6 l0a6a
+ 8 l0a8a l4e46
* 6 l3d37 l0b69 l096b
% a o0c4c4i0i o64a4aa6a l8i24
/ 6 l046i
( 4 s4k0g0642
) 4 s0k4g4602
[ 4 l4i0i0444
] 4 l0i4i4404
= 8 l0c8c l0888
< 8 l8e0986
> 8 l0e8906
_ 8 l0282
' 0 l0i0f
\" 3 l0i0f l3i3f
! 0 l0i08 l0405
? 7 s0f0i7i7c3a l3a38 l3435
# a l244i l648i l0cac l08a8
\u{b0} 4 o0e4e4i0i
\u{b7} 0 l0a0b
\u{d7} 6 l066c l0c66
";

/// Width of `text` in pixels, its capitals being `size` pixels high.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    let units: f64 = text.chars().map(|c| advance(c) + SPACING).sum();
    (units - SPACING).max(0.0) * size / CAPITAL
}

/// Draws `text` from (x, y) on its base line, capitals `size` pixels high.
pub(crate) fn draw_text(brush: &mut Brush, text: &str, [x, y]: [f64; 2], size: f64, color: [u8; 3]) {
    let unit = size / CAPITAL;
    let mut pen = x;
    for letter in text.chars() {
        if let Some(strokes) = strokes(letter) {
            for stroke in strokes {
                if let Some(path) = outline(stroke, |p| [pen + p[0] * unit, y - (p[1] - 4.0) * unit]) {
                    brush.stroke(&path, (size * 0.115).max(1.0) as f32, color);
                }
            }
        }
        pen += (advance(letter) + SPACING) * unit;
    }
}

fn entry(letter: char) -> Option<std::str::SplitAsciiWhitespace<'static>> {
    let line = LETTERS.lines().find(|line| line.starts_with(letter) && !letter.is_whitespace())?;
    let mut words = line.split_ascii_whitespace();
    words.next();
    Some(words)
}

fn advance(letter: char) -> f64 {
    let width = entry(letter).and_then(|mut words| words.next()).and_then(|w| w.chars().next()).and_then(digit);
    width.unwrap_or(5.0)
}

fn strokes(letter: char) -> Option<impl Iterator<Item = &'static str>> {
    entry(letter).map(|words| words.skip(1))
}

fn digit(c: char) -> Option<f64> {
    c.to_digit(36).map(f64::from)
}

/// The path of one stroke; smooth curves are uniform quadratic B-splines.
fn outline(stroke: &str, place: impl Fn([f64; 2]) -> [f64; 2]) -> Option<Path> {
    let kind = stroke.chars().next()?;
    let digits: Vec<f64> = stroke.chars().skip(1).filter_map(digit).collect();
    let points: Vec<[f64; 2]> = digits.chunks_exact(2).map(|p| place([p[0], p[1]])).collect();
    let count = points.len();
    let middle = |a: [f64; 2], b: [f64; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let mut builder = PathBuilder::new();
    let quad = |builder: &mut PathBuilder, control: [f64; 2], end: [f64; 2]| {
        builder.quad_to(control[0] as f32, control[1] as f32, end[0] as f32, end[1] as f32);
    };
    match kind {
        'o' if count >= 3 => {
            let start = middle(points[count - 1], points[0]);
            builder.move_to(start[0] as f32, start[1] as f32);
            for k in 0..count {
                quad(&mut builder, points[k], middle(points[k], points[(k + 1) % count]));
            }
            builder.close();
        }
        's' if count >= 3 => {
            builder.move_to(points[0][0] as f32, points[0][1] as f32);
            for k in 1..count - 1 {
                let end = if k == count - 2 { points[count - 1] } else { middle(points[k], points[k + 1]) };
                quad(&mut builder, points[k], end);
            }
        }
        _ => {
            for (k, p) in points.iter().enumerate() {
                let (x, y) = (p[0] as f32, p[1] as f32);
                if k == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
            }
        }
    }
    builder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_has_a_width_and_strokes() {
        for line in LETTERS.lines() {
            let letter = line.chars().next().unwrap();
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            assert!(words.len() >= 3 && words[1].len() == 1, "{line}");
            for stroke in &words[2..] {
                assert!("lso".contains(&stroke[..1]) && stroke.len() % 2 == 1 && stroke.len() >= 5, "{line}");
                assert!(outline(stroke, |p| p).is_some(), "{letter}");
            }
        }
        assert!(text_width("Panels", 10.0) > text_width("Panel", 10.0));
        assert!(('a'..='z').chain('A'..='Z').chain('0'..='9').all(|c| strokes(c).is_some()));
    }
}
